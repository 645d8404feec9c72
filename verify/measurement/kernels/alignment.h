/* Spots at another instant; boxes about LEDs in an image. */
#ifndef VERIFY_ALIGNMENT_H
#define VERIFY_ALIGNMENT_H

#include <stdint.h>

/* Unite boxes (n, 4), x0, y0, x1, y1, that overlap, so that no spot is found twice; return their
 * number. */
int64_t merge_boxes(int64_t n, double *boxes);

#endif
