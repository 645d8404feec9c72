/* Find compact bright blobs of a picture, the candidates for LEDs. */
#ifndef VERIFY_CANDIDATES_H
#define VERIFY_CANDIDATES_H

#include "verify/measurement/detection/kernels/contrast.h"

/* Longest side of a blob's box, px, at a level and at half height; longest axis ratio; least area
 * over its ellipse's. */
typedef struct {
    double side, half_side, axis_ratio, fill;
} Shape;

/* What blobs are searched by. */
typedef struct {
    int64_t reach; /* px: what has brightness at that distance all around is background */
    int64_t n_levels;
    const int64_t *levels; /* (n_levels,), DN of contrast, falling */
    Shape shape;
    int64_t most; /* blobs listed */
} BlobSearch;

/* List candidates in small windows of a grey picture, (most, 4), and count them: blobs of full widths
 * from `least` to `largest`, px, the highest contrast first.
 *
 * `windows` (n, 4): x0, y0, x1, y1, px, cut at the border. Columns: column and row of the centre, px;
 * half width, px; height, DN. */
int64_t search_windows(Grid image, int64_t n, const double *windows, const BlobSearch *search,
                       double least, double largest, int64_t most, double *found);

#endif
