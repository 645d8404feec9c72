/* The covariance of a pose in the directions that its information determines.
 *
 * That of one or two LEDs (or of LEDs on one line) is singular; its null vectors are the motions
 * that no picture shows.
 */
#ifndef VERIFY_DIRECTIONS_H
#define VERIFY_DIRECTIONS_H

#include <stdbool.h>

#define N_FREE 6
#define LEVER 0.1 /* m, the size of a marker: makes metres and radians comparable */

/* m and rad: units in which both are alike */
static const double SCALE[N_FREE] = {LEVER, LEVER, LEVER, 1.0, 1.0, 1.0};

/* Fill in the covariance (6, 6) by an information matrix (6, 6), 1/m^2 and 1/rad^2; `vectors`
 * (6, 6), columns, directions in units of SCALE, in any order, only where one of them is not known;
 * `known` (6,). False where the matrix is not finite. */
bool covariance_of(const double *information, double *inverse, double *vectors, bool *known);

#endif
