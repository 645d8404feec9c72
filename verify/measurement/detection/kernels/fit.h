/* Fit centre and shape of LED spots to their pixels by Gauss-Newton, from what these suggest.
 *
 * Parameter vector, one row a spot:
 *
 *     index  name         meaning                                      unit
 *     0, 1   x, y         centre                                       px from the centre pixel
 *     2      peak         height of the profile                        DN
 *     3      floor        background at the centre pixel               DN
 *     4, 5   slope_x, _y  slope of the background                      DN/px
 *     6-8    xx, xy, yy   inverse square of the half-width ellipse     scale^-2
 *     9      s            ln of the steepness -d ln f / d ln t at t=1  1
 *
 * (observed - mean) / variance times the derivative of the mean is the quasi-score. Weights come from
 * the model, not from the observed value, which would favour pixels whose noise happened to be low. A
 * pixel deep in saturation or below black has a mean that no parameter changes: it carries no
 * information and needs no mask.
 *
 * With r a patch's residuals and D their derivatives by the parameters p, both over the pixels' sigmas
 * (`weigh_pixels`), and W the inverse variances of a prior m, each step solves
 *
 *     (D' D + W + damping) dp = D' r + W (m - p)
 */
#ifndef VERIFY_FIT_H
#define VERIFY_FIT_H

#include "verify/measurement/detection/kernels/patches.h"

#define MIN_INFORMATION 1e-9 /* in every direction: of a patch none of whose pixels counts */
#define TOL_LAST_STEP 10.0 /* of chi^2 that the last step may gain: it is taken, nothing looked at anew */
#define LAST_STEPS 2       /* once the noise is known */
#define MAX_STEPS_FIRST_LOOK 6 /* what has not taken shape by then is no spot */
#define TOL_FIRST_LOOK 1.0     /* of chi^2 in a first look: the place is good to a sigma */

/* Fill in products (m, n) of rows (m, p) with others (n, p), in single precision or in double; m is
 * even, n a multiple of four. Rows with themselves take half the time. */
void multiply_rows(int64_t m, int64_t n, int64_t p, const float *rows, const float *others,
                   bool precise, double *products);

/* Set a spot's prior and start by its pixels; `read`, DN, is the deviation of a dark pixel. */
void expect_spot(Fits *fits, int64_t n, double read);

/* Continue a spot's fit by Gauss-Newton with Levenberg's damping, until it settles.
 *
 * `noise` (3,): read variance, gain and black of one channel. `steps`: at most, 0 weighs the pixels
 * where the fit is. `tolerance`: of chi^2 that a step may still gain: it is taken, and the pixels are
 * not weighed again, but that their means follow. */
void fit_spot(Fits *fits, int64_t n, const double *noise, Table table, int steps, double tolerance);

/* Fit a spot from where its parameters are. */
void fit_from_start(Fits *fits, int64_t n, const double *noise, Table table);

#endif
