/* Cut the pixels around candidates out of a picture, and keep what is fitted to them.
 *
 * The colours of a pixel are combined into one value, weighed by the spot's contrast in each, of
 * which the noise follows.
 */
#include "verify/measurement/detection/kernels/patches.h"

#include "verify/core/kernels/linear_algebra.h"
#include "verify/core/kernels/scratch.h"

/* of a spot's contrast and half-width: what is dimmer and wider beside it is texture of the room */
#define MAX_ROOM 0.35
#define MIN_ROOM_WIDTH 1.5
#define N_RADII 7
#define FIRST_LOOK_STEPS 8 /* from centre to edge of a first look: 197 pixels, whatever the size */
#define MIN_CHANNEL_WEIGHT 0.1 /* of the strongest channel: less adds noise, not information */
#define MIN_CONTRAST 1e-3      /* DN: something to divide by on a flat patch */
#define N_VALUES 256

/* Beyond a sharp LED's rim there is floor alone, of which some shows its slope; a blurred one's light goes
 * on. Of pixels over 15 % of its height a disc has 1.3 times those over half of it, a Gaussian 2.7, and a
 * disc with another light beside it 1.7. */
#define FLOOR_MARGIN 2.0 /* px */
#define SHARP_RATIO 1.4
#define FLANK_REACH 0.7     /* half-widths a unit of that ratio beyond */
#define FLANK_HEIGHT 0.85   /* of a spot's contrast, below its centre */
#define MIN_SHARP_RADIUS 12 /* px: a smaller spot before texture needs all of the room there is */

/* px, of cut-outs: an LED that moves keeps its pixels' number */
static const int64_t RADII[N_RADII] = {8, 11, 14, 18, 26, 40, 62};

/* How far a spot's pixels may be from its centre, px. */
static double needed_reach(const double *spot)
{
    return PATCH_REACH * spot[2] + PATCH_MARGIN;
}

/* Half of a disc's pixels in a row of it, the middle one left out. */
static int64_t half_row(int64_t reach, int64_t row)
{
    return (int64_t)sqrt((double)(reach * reach - row * row));
}

/* How many pixels about a spot, up to `reach`, px, are brighter than its foot, over those that its
 * half-width encloses. */
static double flank_ratio(const Picture *picture, const double *spot, int64_t reach)
{
    int64_t width = picture->width, height = picture->height, channels = picture->channels;
    int64_t x = MIN(MAX((int64_t)rint(spot[0]), 0), width - 1);
    int64_t y = MIN(MAX((int64_t)rint(spot[1]), 0), height - 1);
    const uint8_t *values = picture->values + channels / 2; /* green */
    int32_t foot = values[channels * (width * y + x)] - (int32_t)(FLANK_HEIGHT * spot[3]), bright = 0;
    for (int64_t row = MAX(-reach, -y); row <= MIN(reach, height - 1 - y); row++) {
        int64_t half = half_row(reach, row), end = MIN(x + half, width - 1);
        const uint8_t *line = values + channels * width * (y + row);
        for (int64_t k = MAX(x - half, 0); k <= end; k++)
            bright += line[channels * k] > foot;
    }
    return bright / (acos(-1.0) * square(spot[2]));
}

/* Radius of a spot's pixels, in steps between them: no more than its light and some floor need. */
static int64_t radius_of(const Picture *picture, const double *spot, bool first_look)
{
    double needed = needed_reach(spot);
    int k = 0;
    while (k < N_RADII - 1 && !((double)RADII[k] >= needed))
        k++;
    if (first_look || RADII[k] <= MIN_SHARP_RADIUS)
        return first_look ? FIRST_LOOK_STEPS : RADII[k];
    int64_t reach = (int64_t)MIN(needed, (double)RADII[k]);
    double flank = MAX(flank_ratio(picture, spot, reach) - SHARP_RATIO, 0.0);
    double lit = (SLOPE_REACH + FLANK_REACH * flank) * spot[2] + FLOOR_MARGIN;
    int64_t even = 2 * (int64_t)ceil(lit / 2.0); /* one size, of LEDs nearly alike */
    return MIN(RADII[k], MAX(even, MIN_SHARP_RADIUS));
}

/* How many pixels a disc has. */
static int64_t disc_size(int64_t reach)
{
    int64_t count = 0;
    for (int64_t row = -reach; row <= reach; row++)
        count += 2 * half_row(reach, row) + 1;
    return count;
}

/* Fill in columns and rows of a disc's pixels, so far apart, px, as whole numbers. */
static void disc_offsets(int64_t reach, double spacing, float *column, float *row)
{
    int64_t k = 0;
    for (int64_t y = -reach; y <= reach; y++) {
        int64_t half = half_row(reach, y);
        for (int64_t x = -half; x <= half; x++, k++) {
            column[k] = (float)rint(spacing * (double)x);
            row[k] = (float)rint(spacing * (double)y);
        }
    }
}

/* Make room for what is fitted to n spots. */
static Fits empty_fits(const Picture *picture, int64_t n, const double *spots, bool first_look)
{
    Fits fits = {
        .n = n,
        .origin = TAKE(int64_t, 2 * n),
        .radius = TAKE(int64_t, n),
        .scale = TAKE(double, n),
        .weight = TAKE(double, 3 * n),
        .share = TAKE(double, 2 * n),
        .colour = TAKE(double, 3 * n),
        .level = TAKE(double, n),
        .pixels = TAKE(int64_t, n),
        .begin = TAKE(int64_t, n + 1),
        .prior = TAKE(double, 2 * N_PARAMETERS * n),
        .saturated = TAKE(bool, n),
        .settled = TAKE(bool, n),
        .parameters = TAKE(double, N_PARAMETERS * n),
        .information = TAKE(double, N_PARAMETERS * N_PARAMETERS * n),
        .gradient = TAKE(double, N_PARAMETERS * n),
        .root = TAKE(double, N_PARAMETERS * N_PARAMETERS * n),
        .chi2 = TAKE(double, n),
    };
    fits.begin[0] = 0;
    for (int64_t k = 0; k < n; k++) {
        fits.radius[k] = radius_of(picture, spots + 4 * k, first_look);
        fits.pixels[k] = disc_size(fits.radius[k]);
        fits.begin[k + 1] = fits.begin[k] + pitch(fits.pixels[k]);
    }
    fits.pool = TAKE(float, N_ROWS * fits.begin[n]);
    return fits;
}

int64_t ranked(const int32_t *counts, int64_t rank)
{
    int64_t until = counts[0], value = 0;
    while (until <= rank)
        until += counts[++value];
    return value;
}

/* Fill in where each of p pixels is in the picture, the nearest one if beyond the border; whether
 * it is inside. */
static void find_places(const Picture *picture, const int64_t *origin, int64_t p, float *rows,
                        int64_t *restrict place)
{
    const float *restrict column = rows + ROW_COLUMN * pitch(p);
    const float *restrict row = rows + ROW_ROW * pitch(p);
    float *restrict valid = rows + ROW_VALID * pitch(p);
    int64_t x0 = origin[0], y0 = origin[1], right = picture->width - 1, bottom = picture->height - 1;
#pragma omp simd
    for (int64_t k = 0; k < p; k++) {
        int64_t x = x0 + (int32_t)column[k], y = y0 + (int32_t)row[k];
        int64_t inner_x = MAX(MIN(x, right), 0), inner_y = MAX(MIN(y, bottom), 0);
        valid[k] = (x == inner_x) & (y == inner_y) ? 1.0f : 0.0f;
        place[k] = picture->channels * (inner_y * picture->width + inner_x);
    }
}

/* Read a channel at p places; its values are counted. */
static void read_channel(const uint8_t *values, int64_t p, const int64_t *restrict place,
                         uint8_t *restrict read, int32_t *restrict counts)
{
    memset(counts, 0, sizeof(int32_t) * N_VALUES);
    for (int64_t k = 0; k < p; k++) {
        read[k] = values[place[k]];
        counts[read[k]]++;
    }
}

/* Mean of a channel's values (p,) on the spot less the patch's lower third, DN. */
static double channel_contrast(int64_t p, const uint8_t *restrict read, double scale,
                               const float *rows, const int32_t *counts)
{
    const float *restrict column = rows + ROW_COLUMN * pitch(p);
    const float *restrict row = rows + ROW_ROW * pitch(p);
    int32_t total = 0, core = 0;
    float near2 = (float)(scale * scale);
#pragma omp simd reduction(+ : total, core)
    for (int64_t k = 0; k < p; k++) {
        int32_t near = column[k] * column[k] + row[k] * row[k] <= near2;
        total += near * read[k];
        core += near;
    }
    return (double)total / (double)MAX(core, 1) - (double)ranked(counts, p / 3);
}

/* Fill in the weight of each channel (3,): its contrast `colour` (3,), which is best for equal
 * noise. */
static void channel_weights(const double *colour, double *weight)
{
    double most = MIN_CONTRAST, total = 0.0;
    for (int c = 0; c < 3; c++)
        most = MAX(most, colour[c]);
    for (int c = 0; c < 3; c++) {
        weight[c] = MAX(colour[c], MIN_CONTRAST);
        weight[c] = weight[c] >= MIN_CHANNEL_WEIGHT * most ? weight[c] : 0.0;
        total += weight[c];
    }
    for (int c = 0; c < 3; c++)
        weight[c] /= total;
}

/* Combine the channels (3, p) of a spot's pixels; those clipped in some only are not valid. */
static void combine_colours(int64_t p, const uint8_t *restrict read, const double *weight,
                            float *rows)
{
    float *restrict value = rows + ROW_VALUE * pitch(p);
    float *restrict valid = rows + ROW_VALID * pitch(p);
    float blue = (float)weight[0], green = (float)weight[1], red = (float)weight[2];
#pragma omp simd
    for (int64_t k = 0; k < p; k++)
        value[k] = blue * read[k] + green * read[p + k] + red * read[2 * p + k];
    for (int64_t k = 0; k < p; k++) {
        bool clipped = false, clear = false;
        for (int c = 0; c < 3; c++) {
            bool counts = weight[c] > 0.0, full = read[c * p + k] == (uint8_t)SENSOR_LIMIT;
            clipped |= counts & full;
            clear |= counts & !full;
        }
        valid[k] = clipped & clear ? 0.0f : valid[k];
    }
}

/* Entry of a rank, from 0, of (p,). */
static double value_of_rank(const float *values, int64_t p, int64_t rank)
{
    Mark mark = scratch_mark();
    double *precise = TAKE(double, p);
    for (int64_t k = 0; k < p; k++)
        precise[k] = values[k];
    double found = select_rank(precise, p, rank);
    scratch_release(mark);
    return found;
}

/* Read a spot's pixels, colours combined; those beyond the border are not valid. */
static void read_patch(const Picture *picture, const Fits *fits, int64_t n)
{
    Mark mark = scratch_mark();
    int64_t p = pixels_of(fits, n), *place = TAKE(int64_t, p), low = p * 3 / 10;
    int64_t channels = picture->channels;
    int32_t counts[3][N_VALUES];
    uint8_t *read = TAKE(uint8_t, channels * p);
    float *rows = rows_of(fits, n), *value = rows + ROW_VALUE * pitch(p);
    double *colour = fits->colour + 3 * n, *weight = fits->weight + 3 * n;
    double squares = 0.0, cubes = 0.0;
    find_places(picture, fits->origin + 2 * n, p, rows, place);
    for (int64_t c = 0; c < channels; c++)
        read_channel(picture->values + c, p, place, read + c * p, counts[c]);
    /* channels that hold one picture three times are one measurement, not three */
    bool grey = channels == 1 || (memcmp(read, read + p, (size_t)p) == 0 &&
                                  memcmp(read, read + 2 * p, (size_t)p) == 0);
    for (int c = 0; c < 3; c++) {
        colour[c] = c > 0 && grey ? colour[0] : channel_contrast(p, read + c * p, fits->scale[n],
                                                                 rows, counts[c]);
        weight[c] = c == 0 ? 1.0 : 0.0;
    }
    if (grey) {
        for (int64_t k = 0; k < p; k++)
            value[k] = (float)read[k];
        fits->level[n] = (double)ranked(counts[0], low);
    } else {
        channel_weights(colour, weight);
        combine_colours(p, read, weight, rows);
        fits->level[n] = value_of_rank(value, p, low);
    }
    /* the channels' shares of the signal are the weights themselves, up to a factor */
    for (int c = 0; c < 3; c++) {
        squares += weight[c] * weight[c];
        cubes += weight[c] * weight[c] * weight[c];
    }
    fits->share[2 * n] = squares;
    fits->share[2 * n + 1] = cubes / squares;
    scratch_release(mark);
}

/* Mark as invalid the pixels of a patch that another spot's light reaches first.
 *
 * What overlaps is not told apart here. Texture of the room stays: without so much of a small
 * spot's patch the rest of it moves the centre. */
static void leave_neighbours(const Fits *fits, int64_t own, const double *spots)
{
    int64_t p = pixels_of(fits, own);
    float *rows = rows_of(fits, own), *valid = rows + ROW_VALID * pitch(p);
    const float *column = rows + ROW_COLUMN * pitch(p), *row = rows + ROW_ROW * pitch(p);
    double x0 = (double)fits->origin[2 * own], y0 = (double)fits->origin[2 * own + 1];
    double x = spots[4 * own], y = spots[4 * own + 1], radius = spots[4 * own + 2];
    for (const double *other = spots; other < spots + 4 * fits->n; other += 4) {
        double its_x = other[0], its_y = other[1], its = other[2];
        double off = sqrt(square(its_x - x) + square(its_y - y)) / (radius + its);
        bool room = other[3] < MAX_ROOM * spots[4 * own + 3] && its > MIN_ROOM_WIDTH * radius;
        if (room || !(off > MIN_APART && off < MAX_APART))
            continue;
        #pragma omp simd
        for (int64_t k = 0; k < p; k++) {
            double u = x0 + column[k], w = y0 + row[k];
            double far = sqrt(square(u - its_x) + square(w - its_y)) / its;
            double away = sqrt(square(u - x) + square(w - y)) / radius;
            valid[k] = (far < PATCH_REACH) & (far < away) ? 0.0f : valid[k];
        }
    }
}

Fits cut_patches(const Picture *picture, int64_t n, const double *spots, bool first_look)
{
    Fits fits = empty_fits(picture, n, spots, first_look);
    for (int64_t k = 0; k < n; k++) {
        const double *spot = spots + 4 * k;
        int64_t p = pixels_of(&fits, k);
        float *rows = rows_of(&fits, k);
        for (int axis = 0; axis < 2; axis++)
            fits.origin[2 * k + axis] = (int64_t)rint(spot[axis]);
        fits.scale[k] = spot[2];
        disc_offsets(fits.radius[k],
                     first_look ? needed_reach(spot) / FIRST_LOOK_STEPS : 1.0,
                     rows + ROW_COLUMN * pitch(p), rows + ROW_ROW * pitch(p));
        read_patch(picture, &fits, k);
        static const int READ[] = {ROW_VALUE, ROW_VALID, ROW_COLUMN, ROW_ROW};
        for (int i = 0; i < 4; i++)
            clear_behind(p, rows + READ[i] * pitch(p));
        if (!first_look)
            leave_neighbours(&fits, k, spots);
    }
    return fits;
}
