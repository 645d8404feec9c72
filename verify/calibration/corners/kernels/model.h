/* A corner's pixels: two blurred edges that cross, between squares of two colours. */
#ifndef VERIFY_CORNER_MODEL_H
#define VERIFY_CORNER_MODEL_H

#include <stdbool.h>
#include <stdint.h>

#define HALF_WINDOW 0.5 /* squares */

/* Of the window, for the scatter of scores; odd: edges lie within cells. */
enum { CELLS_PER_SIDE = 7, N_CELLS = CELLS_PER_SIDE * CELLS_PER_SIDE };

/* The fixed part of the model: rad, directions of the edges' normals; 1/px, curvatures along them;
 * px, unit of the linear terms. */
enum { EDGE_START_1, EDGE_START_2, EDGE_BEND_1, EDGE_BEND_2, EDGE_SCALE, N_EDGE_VALUES };

/* Place, px; turns, rad; logarithms of the blurs in px; spread, px; the rest DN. The rows of pixels
 * are the derivatives by them, and behind these the pixels less the model, DN. */
enum { PAR_X, PAR_Y, PAR_TURN_1, PAR_TURN_2, PAR_BLUR_1, PAR_BLUR_2, PAR_SPREAD, PAR_SHADE,
       PAR_SHADE_X, PAR_SHADE_Y, PAR_CONTRAST, PAR_TILT_X, PAR_TILT_Y, N_PARAMETERS,
       ROW_RESIDUAL = N_PARAMETERS, N_ROWS };

/* F and its slope at every step from -end to end. Between the steps a series is off by 1e-15, the
 * slope by 1e-12. */
#define TABLE_STEP (1.0 / 64.0)

typedef struct {
    const double *shares, *slopes;
    double end; /* were it a constant, gcc would branch on it and take pixels one by one */
} Table;

/* The table of (2, n) values: F, and its slope. */
static inline Table table_of(int64_t n, const double *values)
{
    return (Table){values, values + n, (double)(n / 2) * TABLE_STEP};
}

/* An image, (h, w), DN. */
typedef struct {
    int64_t height, width;
    const uint8_t *values;
} Picture;

/* What is known of each of a corner's pixels: px from the expected centre; DN; its cell, which is
 * one with its mirror image about the corner. */
typedef struct {
    int64_t count;
    double *column, *row, *value, *cell;
} CornerPixels;

CornerPixels take_pixels(int64_t count);

/* Take the pixels within half a square, near an edge, and outside ChArUco markers, at the expected
 * centre (2,), px, with the jacobian (2, 2) d px / d squares, columns along the board's x and y.
 * `markers` (2,): squares between a marker and its square's edge; sign of u v (from the corner,
 * board's axes) where the white squares are, 0 where none has a marker. */
CornerPixels window_pixels(Picture grey, const double *centre, const double *jacobian,
                           const double *markers);

/* Fill in directions and curvatures of the two edges (5,), from the board's plane; `bend` (2, 2) is
 * d^2 px / d squares^2, columns along the board's x and y. */
void fill_edges(const double *jacobian, const double *bend, double *edges);

/* Take those of the pixels that keep clear of stray ones, as far as blur reaches. */
CornerPixels keep_clear(CornerPixels pixels, const bool *stray);

/* Fill in what to start from (13,); the contrast from the means of the quadrants. `blurs` (3,): of
 * the edges along the board's x and y, as logarithms, and the spread of the brighter colour. */
void start_values(CornerPixels pixels, const double *edges, const double *blurs, double *p);

/* Expect a corner's pixels by its edges (5,), parameters p (13,) and F's table; fill in the rows
 * (14, p), which stand `stride` apart. */
void predict_pixels(CornerPixels pixels, const double *edges, const double *p, Table table,
                    int64_t stride, double *rows);

#endif
