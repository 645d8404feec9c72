/* Correct spots for a sliver of the rim that something before them hides. */
#ifndef VERIFY_OCCLUSION_H
#define VERIFY_OCCLUSION_H

#include "verify/measurement/detection/kernels/patches.h"

#define N_DIRECTIONS 24 /* round the rim: steps of 15 degrees, under a bite's own width */

/* Score the bites of m spots of a picture that have one LED's shape; others have none.
 *
 * `kept` (m,), of the fits; `assessed` (m, 16), theirs. Filled: `score` (m, 4, 24): gradient and
 * information of the log-likelihood by a bite's depth in each direction, half-widths^-1 and ^-2;
 * shift of the centre a unit of depth, in x and in y, px; 0 of no bite. `asymmetry` (m,): chi^2 of
 * each spot's likeliest bite, for noise as stated; inf of spots so far out of focus that none
 * shows. */
void score_spots(const Fits *fits, int64_t m, const int64_t *kept, const double *assessed,
                 double *score, double *asymmetry);

/* Average over all bites that m spots of a picture may have; none without one LED's shape.
 *
 * `score` (m, 4, 24), as by `score_spots`; `assessed` (m, 16). To `moments` (m, 2, 3) is added what
 * makes the centres those of the whole discs, px, and its covariance, px^2. */
void correct_for_bites(int64_t m, const double *score, const double *assessed, double *moments);

#endif
