/* Noise of a picture's pixels, by its quietest part.
 *
 * Model of a pixel's variance, s being the signal above black:
 *
 *     var(s) = read^2 + gain s,   DN^2
 *
 *     symbol  meaning                                             unit
 *     read    standard deviation in the dark, with quantisation   DN
 *     gain    shot noise: variance a unit of signal               DN
 *     black   level at which the signal is zero                   DN
 */
#ifndef VERIFY_NOISE_H
#define VERIFY_NOISE_H

#include "verify/measurement/detection/kernels/patches.h"

#define TYPICAL_GAIN (1.0 / 35.0) /* DN, 9,000 electrons over 255 DN: a usual small pixel */
#define TYPICAL_SPREAD 1.0        /* relative, how far a sensor may be from typical */
#define INDEPENDENT_SHARE 0.5 /* of independent information: neighbours' differences overlap */

/* Fill in the noise (4,) of the quietest part of an image: read variance, DN^2; gain, DN, a usual one;
 * black, DN; the relative uncertainty of the first. */
void background_noise(const Picture *picture, bool lossy, double *noise);

#endif
