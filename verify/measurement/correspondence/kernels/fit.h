/* Fit a pose and a shift of the right image to the spots of many hypotheses.
 *
 * With u the LEDs' images predicted at pose T and shift s, z their spots, V the spots' covariance,
 * H a weight that keeps the pose and S the variance of the shift, each Gauss-Newton step minimises
 *
 *     chi^2 = sum (z - u(T, s))' V^-1 (z - u(T, s)) + dT' H dT + s' s / S
 */
#ifndef VERIFY_CORRESPONDENCE_FIT_H
#define VERIFY_CORRESPONDENCE_FIT_H

#include <stdbool.h>
#include <stdint.h>

#define N_FREE 8 /* pose and shift */

/* Where the figures of a hypothesis stand in its row: rotation (3, 3), position (3,) m, shift (2,)
 * px, inverse variances (6,) by which a step keeps the pose, chi^2, covariance (8, 8). */
enum { POSITION = 9, SHIFT = 12, HOLD = 14, CHI2 = 20, COVARIANCE = 21,
       N_STATE = COVARIANCE + N_FREE * N_FREE };

/* Cameras, spots and marker; s spots an image, NaN where there is none, n LEDs. What follows them is
 * for fits alone: m, depth below which nothing is imaged; m px, an LED's play times the focal
 * length; 1/px^2, inverse variance of the shift. */
typedef struct {
    const double *camera_R_rig, *center, *focal; /* (2, 3, 3); (2, 3) m; (2, 2) px */
    int64_t n_spots;
    const double *pixels, *covariance; /* (2, s, 2) px; (2, s, 2, 2) px^2 */
    const bool *merged, *allowed;      /* (2, s); (2, n, s), this spot may be that LED */
    int64_t n_leds;
    const double *leds; /* (n, 3) m, flange frame */
    double nearest, play, shift_weight;
} Scene;

/* The scene of an entry, made of its arguments of these names, and of three limits. */
#define SCENE(nearest, play, shift_weight)                                                      \
    (&(Scene){camera_R_rig, center, focal, n_spots, pixels, covariance, merged, allowed,        \
              n_leds, leds, nearest, play, shift_weight})

/* Predict one LED's image in one camera, left or right, without the shift; gives the depth, m.
 *
 * `state`: rotation (3, 3), rig_R_flange, and position (3,), m. Filled: `pixel` (2,), and of
 * `derivative` (2, 8) the first six columns, by position and rotation vector. */
double predict_image(const Scene *scene, int side, int64_t led, const double *state, double *pixel,
                     double *derivative);

/* Fill in what a hypothesis (85,) has beside its pose before its first fit. `sigmas` (3,): standard
 * deviations by which steps keep the pose, m and rad, and of the shift, px. */
void begin_fit(double *state, const double *sigmas);

/* Fit hypotheses in place by Gauss-Newton, their spots held.
 *
 * Of `state` (count, 85) all but what keeps the pose is changed; chi^2 includes the shift's share.
 * `chosen` (count, 2, n): spots, -1 for none. 0 `steps` compute covariance and chi^2 alone. */
void fit_all(const Scene *scene, int64_t count, double *state, const int64_t *chosen, int steps);

#endif
