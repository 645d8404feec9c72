/* Correct spots for the room that a bright camera shows behind them, and widen them by the rest. */
#ifndef VERIFY_BACKGROUND_H
#define VERIFY_BACKGROUND_H

#include "verify/measurement/detection/kernels/surroundings.h"

/* `kept` (m,), of the fits; `assessed` (m, 16), theirs. To `moments` (m, 2, 3), shift, px, and
 * covariance, px^2, is added. */
void correct_for_room(const Surroundings *around, const Fits *fits, int64_t m, const int64_t *kept,
                      const double *assessed, double *moments);

#endif
