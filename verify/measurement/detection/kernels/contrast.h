/* Contrast of a picture, above its surroundings, and regions above a level of it. */
#ifndef VERIFY_CONTRAST_H
#define VERIFY_CONTRAST_H

#include <stdbool.h>
#include <stdint.h>

#define BOX_MARGIN 2 /* px about a region's box: its half height may lie below the level */

/* Values (height, width), DN. */
typedef struct {
    const uint8_t *values;
    int64_t height, width;
} Grid;

/* px, upper bounds exclusive. */
typedef struct {
    int64_t left, top, right, bottom;
} Box;

/* A box and a margin about it, as far as it is inside a picture. */
Box widen(Box box, int64_t margin, Grid picture);

/* Copies, scratch: of what a box inside a picture holds; of all, between so many rows of 255 above
 * and below, columns beside. */
Grid cut_out(Grid picture, Box box);
Grid enclose(Grid picture, int64_t above, int64_t beside);

/* Greatest of (n,), or 0. */
static inline uint8_t greatest(int64_t n, const uint8_t *values)
{
    uint8_t most = 0;
    for (int64_t i = 0; i < n; i++)
        most = values[i] > most ? values[i] : most;
    return most;
}

/* Contrast in a window inside an image, scratch: the image less its opening by a square of
 * 2 reach + 1 px. A margin about the window counts: 0, or 2 reach. Borders hold nothing. */
Grid top_hat(Grid image, Box window, int64_t margin, int64_t reach);

/* Label what is above a level and connected with the pixel at a place, row by row; give its box.
 *
 * `label`, of the picture's shape; `corners`: whether these connect, too. */
Box flood_fill(Grid picture, int64_t level, int64_t place, bool corners, int32_t *label,
               int32_t number);

#endif
