/* Bring the spots of one image into ideal coordinates, with noise, and say which LED each may be. */
#ifndef VERIFY_CORRESPONDENCE_VIEWS_H
#define VERIFY_CORRESPONDENCE_VIEWS_H

#include <stdbool.h>
#include <stdint.h>

/* m spots: centres (m, 2) px, covariance (m, 2, 2) px^2; which are merged, saturated (m,); colour
 * (m, 3). */
typedef struct {
    int64_t count;
    const double *centre, *noise;
    const bool *merged, *saturated;
    const double *colour;
} ImageSpots;

/* Fill in one image's spots, the first `most` of them, or fewer where there are no more.
 *
 * `matrix` (3, 3), px, and `lens` (5,) of the camera. `beside`, px^2: variance beside the noise;
 * `dragged`: that of a merged spot in addition. `light` (n,), of each LED: BLUE to ANY. Filled:
 * `pixels` (most, 2), ideal px, NaN where there is no spot; `covariance` (most, 2, 2), px^2;
 * `merged` (most,); `allowed` (n, most): this spot may be that LED.
 *
 * Only clear contradictions count. A spot with no clear hue may be white, infrared (cameras show it
 * whitish or violet) or, where saturated, any overexposed LED; in a grey image every spot may be
 * any LED. */
void prepare_image(ImageSpots spots, const double *matrix, const double *lens, double beside,
                   double dragged, int64_t n_leds, const int64_t *light, int64_t most,
                   double *pixels, double *covariance, bool *merged, bool *allowed);

#endif
