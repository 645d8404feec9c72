/* Model a corner's pixels: two blurred edges that cross, between squares of two colours.
 *
 * A pixel is shade(x) + contrast(x) cross(x), shade and contrast linear over the window. With F the
 * normal distribution, d1 and d2 the distances from the two edges, b1 and b2 their blur,
 *
 *     cross = 1 - 2 F((d1 - e) / b1) F((-d2 - e) / b2) - 2 F((-d1 - e) / b1) F((d2 - e) / b2)
 *
 * where e is by how much one colour has spread over the other: ink, or light where white saturates.
 *
 * Its pixels are those within half a square in the board's plane: each piece of an edge belongs to
 * one corner, no two corners share a pixel, and their errors are independent. Perspective leaves
 * edges straight; the lens bends them, by how much is taken from the whole view's map.
 */
#include "verify/calibration/corners/kernels/model.h"
#include "verify/core/kernels/linear_algebra.h"
#include "verify/core/kernels/scratch.h"

#define MAX_EDGE_DISTANCE 10.0 /* px; beyond it from both edges a pixel says nothing on them */
#define MARKER_GUARD 2.0       /* px, blur that a ChArUco marker's bits may have */
#define CLEARANCE 2            /* px between what is not the corner's and what speaks for it */

CornerPixels take_pixels(int64_t count)
{
    return (CornerPixels){count, TAKE(double, count), TAKE(double, count), TAKE(double, count),
                          TAKE(double, count)};
}

/* Columns (or rows) from the first to the one after the last that half a square may reach; none
 * where the centre is no number. */
static void pixel_range(double centre, const double *slopes, int64_t size, int64_t *range)
{
    double extent = HALF_WINDOW * (fabs(slopes[0]) + fabs(slopes[1])), end = (double)size;
    range[0] = (int64_t)MIN(end, MAX(0.0, ceil(centre - extent)));
    range[1] = (int64_t)MIN(end, MAX(0.0, floor(centre + extent) + 1.0));
}

CornerPixels window_pixels(Picture grey, const double *centre, const double *jacobian,
                           const double *markers)
{
    double xx = jacobian[0], xy = jacobian[1], yx = jacobian[2], yy = jacobian[3];
    double determinant = xx * yy - xy * yx, white = markers[1];
    /* A pixel's distance from the edge along the board's x is across it, hence its v, and so on. */
    double step_u = fabs(determinant) / hypot(xy, yy), step_v = fabs(determinant) / hypot(xx, yx);
    double margin = markers[0] * MIN(step_u, step_v) - MARKER_GUARD, last = CELLS_PER_SIDE - 1;
    int64_t columns[2], rows[2], count = 0;
    pixel_range(centre[0], jacobian, grey.width, columns);
    pixel_range(centre[1], jacobian + 2, grey.height, rows);
    int64_t width = MAX(columns[1] - columns[0], 0), height = MAX(rows[1] - rows[0], 0);
    CornerPixels found = take_pixels(width * height);
    double *restrict own = TAKE(double, width), *restrict cells = TAKE(double, width);
    double first = (double)columns[0];
    for (int64_t y = rows[0]; y < rows[1]; y++) {
        double row = (double)y - centre[1];
#pragma omp simd
        for (int32_t k = 0; k < width; k++) {
            double column = first + (double)k - centre[0];
            double u = (column * yy - row * xy) / determinant, across = fabs(u);
            double v = (row * xx - column * yx) / determinant, along = fabs(v);
            double away = MIN(across * step_u, along * step_v);
            bool plain = (white == 0.0) | (away <= margin) | (u * v * white < 0.0);
            bool inside = (across <= HALF_WINDOW) & (along <= HALF_WINDOW);
            own[k] = inside & plain & (away <= MAX_EDGE_DISTANCE) ? 1.0 : 0.0;
            double i = floor((u / HALF_WINDOW + 1.0) * CELLS_PER_SIDE / 2.0);
            double j = floor((v / HALF_WINDOW + 1.0) * CELLS_PER_SIDE / 2.0);
            double cell = MIN(i, last) * CELLS_PER_SIDE + MIN(j, last);
            cells[k] = MIN(cell, N_CELLS - 1 - cell);
        }
        for (int64_t k = 0; k < width; k++) {
            found.column[count] = first + (double)k - centre[0];
            found.row[count] = row;
            found.value[count] = grey.values[y * grey.width + columns[0] + k];
            found.cell[count] = cells[k];
            count += own[k] > 0.0; /* else the next one overwrites it */
        }
    }
    found.count = count;
    return found;
}

void fill_edges(const double *jacobian, const double *bend, double *edges)
{
    for (int along = 0; along < 2; along++) {
        double x = jacobian[along], y = jacobian[2 + along];
        double across = jacobian[3 - along] * x - jacobian[1 - along] * y;
        double length = copysign(hypot(x, y), across);
        double normal_x = -y / length, normal_y = x / length;
        edges[EDGE_START_1 + along] = atan2(normal_y, normal_x);
        double bent = bend[along] * normal_x + bend[2 + along] * normal_y;
        edges[EDGE_BEND_1 + along] = bent / (length * length);
    }
    edges[EDGE_SCALE] = sqrt(fabs(jacobian[0] * jacobian[3] - jacobian[1] * jacobian[2]));
}

CornerPixels keep_clear(CornerPixels pixels, const bool *stray)
{
    double left = INFINITY, right = -INFINITY, top = INFINITY, bottom = -INFINITY;
    for (int64_t k = 0; k < pixels.count; k++) {
        left = MIN(left, pixels.column[k]);
        right = MAX(right, pixels.column[k]);
        top = MIN(top, pixels.row[k]);
        bottom = MAX(bottom, pixels.row[k]);
    }
    CornerPixels kept = take_pixels(pixels.count);
    kept.count = 0;
    Mark mark = scratch_mark();
    int64_t side = 2 * CLEARANCE + 1, width = (int64_t)(right - left + 0.5) + side;
    int64_t area = ((int64_t)(bottom - top + 0.5) + side) * width;
    int64_t *at = TAKE(int64_t, pixels.count); /* top left of what a pixel is to keep clear of */
    bool *near = TAKE(bool, area);
    memset(near, false, (size_t)area);
    for (int64_t k = 0; k < pixels.count; k++) {
        int64_t x = (int64_t)(pixels.column[k] - left + 0.5);
        at[k] = (int64_t)(pixels.row[k] - top + 0.5) * width + x;
        if (stray[k])
            for (int64_t y = 0; y < side; y++)
                memset(near + at[k] + y * width, true, (size_t)side);
    }
    for (int64_t k = 0; k < pixels.count; k++) {
        kept.column[kept.count] = pixels.column[k];
        kept.row[kept.count] = pixels.row[k];
        kept.value[kept.count] = pixels.value[k];
        kept.cell[kept.count] = pixels.cell[k];
        kept.count += !near[at[k] + CLEARANCE * width + CLEARANCE];
    }
    scratch_release(mark);
    return kept;
}

void start_values(CornerPixels pixels, const double *edges, const double *blurs, double *p)
{
    double cos_1 = cos(edges[EDGE_START_1]), sin_1 = sin(edges[EDGE_START_1]);
    double cos_2 = cos(edges[EDGE_START_2]), sin_2 = sin(edges[EDGE_START_2]);
    double high = 0.0, highs = 0.0, low = 0.0, lows = 0.0;
#pragma omp simd reduction(+ : high, highs, low, lows)
    for (int64_t k = 0; k < pixels.count; k++) {
        double x = pixels.column[k], y = pixels.row[k];
        double same = (x * cos_1 + y * sin_1) * (x * cos_2 + y * sin_2);
        high += same > 0.0 ? pixels.value[k] : 0.0;
        highs += same > 0.0 ? 1.0 : 0.0;
        low += same < 0.0 ? pixels.value[k] : 0.0;
        lows += same < 0.0 ? 1.0 : 0.0;
    }
    high /= MAX(highs, 1.0);
    low /= MAX(lows, 1.0);
    clear(p, N_PARAMETERS);
    p[PAR_TURN_1] = edges[EDGE_START_1];
    p[PAR_TURN_2] = edges[EDGE_START_2];
    p[PAR_SHADE] = (high + low) / 2.0;
    p[PAR_CONTRAST] = (high - low) / 2.0;
    p[PAR_BLUR_1] = blurs[0];
    p[PAR_BLUR_2] = blurs[1];
    p[PAR_SPREAD] = copysign(blurs[2], blurs[2] * p[PAR_CONTRAST]);
}

/* F of a place over the blur's width, and the size of its slope, 1/px. */
typedef struct {
    double share, near;
} Step;

/* Source: Taylor's series about the nearest step of the table; F's derivatives are Hermite's
 * polynomials times its slope. */
static inline Step blurred_step(double place, double inverse, Table table)
{
    double z = MIN(table.end, MAX(-table.end, place * inverse)); /* -end if it is no number */
    int32_t nearest = (int32_t)((z + table.end) * (1.0 / TABLE_STEP) + 0.5);
    double u = nearest * TABLE_STEP - table.end, d = z - u, uu = u * u;
    double second = uu * (1.0 / 2.0) - 1.0 / 2.0, third = u * (1.0 / 2.0 - uu * (1.0 / 6.0));
    double fourth = (uu * (1.0 / 24.0) - 1.0 / 4.0) * uu + 1.0 / 8.0;
    double share = second * (1.0 / 3.0) + d * (third * (1.0 / 4.0) + d * (fourth * (1.0 / 5.0)));
    double near = second + d * (third + d * fourth), slope = table.slopes[nearest];
    return (Step){table.shares[nearest] + slope * d * (1.0 + d * (d * share - u * (1.0 / 2.0))),
                  slope * inverse * (1.0 + d * (d * near - u))};
}

/* An edge as the parameters place it, and a pixel by it: its place along and across it, px; the
 * share of its light from beyond the edge, drawn back by the spread, and from the other side. */
typedef struct {
    double cosine, sine, bend, inverse;
} Edge;

typedef struct {
    double along, distance;
    Step above, below;
} Placed;

static Edge edge_at(const double *edges, const double *p, int which)
{
    double turn = p[PAR_TURN_1 + which], width = exp(p[PAR_BLUR_1 + which]);
    return (Edge){cos(turn), sin(turn), edges[EDGE_BEND_1 + which], 1.0 / width};
}

static inline Placed place_pixel(double x, double y, Edge edge, double spread, Table table)
{
    double along = y * edge.cosine - x * edge.sine;
    double distance = x * edge.cosine + y * edge.sine - edge.bend / 2.0 * along * along;
    return (Placed){along, distance, blurred_step(distance - spread, edge.inverse, table),
                    blurred_step(-distance - spread, edge.inverse, table)};
}

/* How `cross` changes with the distance from an edge, negated and halved, 1/px. */
static inline double by_distance(Placed one, Placed other)
{
    return one.below.near * other.above.share - one.above.near * other.below.share;
}

/* How it changes with the logarithm of an edge's blur, halved. */
static inline double by_blur(Placed one, Placed other, double spread)
{
    return (one.distance - spread) * one.above.near * other.below.share
        - (one.distance + spread) * one.below.near * other.above.share;
}

/* How it changes with the spread, as far as one edge goes, halved. */
static inline double by_spread(Placed one, Placed other)
{
    return one.above.near * other.below.share + one.below.near * other.above.share;
}

/* How an edge's distance from a pixel changes with its turn, px. */
static inline double by_turn(Placed at, Edge edge)
{
    return at.along * (1.0 + edge.bend * (at.distance + edge.bend / 2.0 * at.along * at.along));
}

void predict_pixels(CornerPixels pixels, const double *edges, const double *p, Table table,
                    int64_t stride, double *restrict rows)
{
    Edge one = edge_at(edges, p, 0), two = edge_at(edges, p, 1);
    double x0 = p[PAR_X], y0 = p[PAR_Y], spread = p[PAR_SPREAD], per_px = 1.0 / edges[EDGE_SCALE];
    double shade = p[PAR_SHADE], shade_x = p[PAR_SHADE_X], shade_y = p[PAR_SHADE_Y];
    double contrast = p[PAR_CONTRAST], tilt_x = p[PAR_TILT_X], tilt_y = p[PAR_TILT_Y];
    int64_t n = pixels.count;
#pragma omp simd
    for (int64_t k = 0; k < n; k++) {
        double x = pixels.column[k], y = pixels.row[k], right = x * per_px, down = y * per_px;
        Placed a = place_pixel(x - x0, y - y0, one, spread, table);
        Placed b = place_pixel(x - x0, y - y0, two, spread, table);
        double colour = contrast + tilt_x * right + tilt_y * down, twice = 2.0 * colour;
        double by_1 = twice * by_distance(a, b), by_2 = twice * by_distance(b, a);
        /* Of the quadrants between the edges one diagonal pair is drawn over the other's ground. */
        double drawn = a.above.share * b.below.share + a.below.share * b.above.share;
        double cross = 1.0 - 2.0 * drawn, ground = shade + shade_x * right + shade_y * down;
        rows[PAR_X * stride + k] = -(one.cosine + one.bend * one.sine * a.along) * by_1
            - (two.cosine + two.bend * two.sine * b.along) * by_2;
        rows[PAR_Y * stride + k] = (one.bend * one.cosine * a.along - one.sine) * by_1
            + (two.bend * two.cosine * b.along - two.sine) * by_2;
        rows[PAR_TURN_1 * stride + k] = by_1 * by_turn(a, one);
        rows[PAR_TURN_2 * stride + k] = by_2 * by_turn(b, two);
        rows[PAR_BLUR_1 * stride + k] = twice * by_blur(a, b, spread);
        rows[PAR_BLUR_2 * stride + k] = twice * by_blur(b, a, spread);
        rows[PAR_SPREAD * stride + k] = twice * (by_spread(a, b) + by_spread(b, a));
        rows[PAR_SHADE * stride + k] = 1.0;
        rows[PAR_SHADE_X * stride + k] = right;
        rows[PAR_SHADE_Y * stride + k] = down;
        rows[PAR_CONTRAST * stride + k] = cross;
        rows[PAR_TILT_X * stride + k] = cross * right;
        rows[PAR_TILT_Y * stride + k] = cross * down;
        rows[ROW_RESIDUAL * stride + k] = pixels.value[k] - ground - colour * cross;
    }
}

static int64_t copy_window(Picture grey, const double *centre, const double *jacobian,
                           const double *markers, int64_t room, double *found)
{
    CornerPixels pixels = window_pixels(grey, centre, jacobian, markers);
    copy(found, pixels.column, pixels.count);
    copy(found + room, pixels.row, pixels.count);
    copy(found + 2 * room, pixels.value, pixels.count);
    copy(found + 3 * room, pixels.cell, pixels.count);
    return pixels.count;
}

/* Fill in the first columns of (4, room), room for all pixels of the picture; gives how many. */
int64_t entry_window_pixels(int64_t height, int64_t width, const uint8_t *grey,
                            const double *centre, const double *jacobian, const double *markers,
                            int64_t room, double *found)
{
    GUARDED(copy_window((Picture){height, width, grey}, centre, jacobian, markers, room, found));
}

int64_t entry_fill_edges(const double *jacobian, const double *bend, double *edges)
{
    fill_edges(jacobian, bend, edges);
    return 0;
}

int64_t entry_predict_pixels(int64_t n, double *pixels, const double *edges, const double *p,
                             int64_t n_steps, const double *steps, double *rows)
{
    CornerPixels at = {n, pixels, pixels + n, pixels + 2 * n, pixels + 3 * n};
    predict_pixels(at, edges, p, table_of(n_steps, steps), n, rows);
    return 0;
}
