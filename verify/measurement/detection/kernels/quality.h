/* Assess fitted spots: covariance, shape, and which of them are LEDs. */
#ifndef VERIFY_QUALITY_H
#define VERIFY_QUALITY_H

#include "verify/measurement/detection/kernels/patches.h"

/* parameters that a spot's own pixels pay for; the slopes live on the surroundings. With few pixels
 * left, of a spot far over the limit, its foot pays for them */
#define N_FITTED 8.0
/* pixels that a wrong shape lifts together, so that they do not average */
#define CORRELATED_PIXELS 20.0
#define MIN_NOISE_SHARE 0.9f   /* of a pixel's noise that clipping must leave for its residual */

/* columns of an assessed spot: centre (px), covariance (px^2), peak (DN), full width at half height
 * (px), axis ratio, reduced chi^2; flags (0 or 1): pixels at the sensor's limit, no single LED's
 * shape, a spot at all; how many of its own pixels clipping leaves alone; by how much the longest
 * width exceeds the shortest (px), times cosine and sine of twice the longest one's direction;
 * reduced chi^2 if what texture of the room adds about the spot is noise; variance of a coordinate by
 * noise and texture alone (px^2) */
enum { COL_CENTRE_X, COL_CENTRE_Y, COL_COVARIANCE_XX, COL_COVARIANCE_XY, COL_COVARIANCE_YX,
       COL_COVARIANCE_YY, COL_PEAK, COL_DIAMETER, COL_ELONGATION, COL_MISFIT, COL_SATURATED,
       COL_MERGED, COL_SOUND, COL_COUNT, COL_STRETCH_X, COL_STRETCH_Y, COL_SHAPE, COL_NOISE, N_COLUMNS };

/* Fill in the assessment (n, 18) of n fits; `lifted`, pixels that misfit beyond chance lifts. */
void assess_all(const Fits *fits, int64_t width, int64_t height, double lifted, double *assessed);

/* Make the covariances of a JPEG's n spots (n, 18) those of its errors, which are not white. */
void widen_lossy(int64_t n, double *assessed);

/* Flag those of n spots (n, 18) that are stretched alone; widen what is merged. `asymmetry` (n,),
 * chi^2 of a bite out of each, for noise as stated; inf where none would show. */
void doubt_shapes(int64_t n, double *assessed, const double *asymmetry);

/* Choose the most LED-like of n spots (n, 18), no more than the limit, by falling peak; `kept` (n,)
 * is filled with as many as it gives. Diameters, px. */
int64_t choose_spots(int64_t n, const double *assessed, double least, double largest, int64_t limit,
                     int64_t *kept);

#endif
