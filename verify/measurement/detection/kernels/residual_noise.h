/* Noise of a picture's pixels, by the residuals of clean spots too. */
#ifndef VERIFY_RESIDUAL_NOISE_H
#define VERIFY_RESIDUAL_NOISE_H

#include "verify/measurement/detection/kernels/patches.h"

/* Let noise (3,) also explain the residuals of clean spots; `assessed` (n, 18), `spread` the relative
 * standard uncertainty of the dark variance. */
void refine_noise(const Fits *fits, const double *assessed, double *noise, double spread);

#endif
