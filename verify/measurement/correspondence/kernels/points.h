/* Pair spots of two images whose rays nearly meet, and say where they meet and how well. */
#ifndef VERIFY_CORRESPONDENCE_POINTS_H
#define VERIFY_CORRESPONDENCE_POINTS_H

#include <stdint.h>

#define MAX_DEVIATION 4.0 /* standard deviations: a true LED is turned away once in 16,000 */

/* Put a row (width,) among those that cost least, in rising order, equal ones as they came.
 *
 * Of `costs` (most,) and `rows` (most, width) the first `count` are taken; the greatest is lost
 * where all are. Gives how many there are then. */
int64_t insert_cost(double cost, const int64_t *row, int width, int64_t most, double *costs,
                    int64_t *rows, int64_t count);

#endif
