/* Noise of a picture's pixels: of its quietest part, and of the residuals of clean spots. */
#ifndef VERIFY_NOISE_H
#define VERIFY_NOISE_H

#include "verify/measurement/detection/kernels/patches.h"

/* Fill in the noise (4,) of the quietest part of an image: read variance, DN^2; gain, DN, a usual one;
 * black, DN; the relative uncertainty of the first. */
void background_noise(const Picture *picture, bool lossy, double *noise);

/* Let noise (3,) also explain the residuals of clean spots; `assessed` (n, 16), `spread` the relative
 * standard uncertainty of the dark variance. */
void refine_noise(const Fits *fits, const double *assessed, double *noise, double spread);

#endif
