#include "verify/measurement/detection/kernels/surroundings.h"

#include <math.h>

#include "verify/core/kernels/linear_algebra.h"
#include "verify/core/kernels/scratch.h"

#define MIN_AROUND 12 /* responses, two a patch: fewer show nothing */
#define MAX_DIM 0.5   /* of a spot's peak: a light that is less may be texture of the room */
#define MAX_OWN 3.0   /* of the usual: a spot's own surroundings move it more than chance */
#define EIGHTH_TURN 0.7853981633974483 /* rad */
#define MEDIAN_CHI2 0.4549 /* of chi^2 with one degree of freedom */

/* Take mean and slopes off the weights (p,) of a disc's pixels: planes move nothing then. */
static void leave_planes(int64_t p, const float *rows, double *weight)
{
    const float *column = rows + ROW_COLUMN * p, *row = rows + ROW_ROW * p;
    double total = 0.0, right = 0.0, down = 0.0, lever = 0.0;
#pragma omp simd reduction(+ : total, right, down, lever)
    for (int64_t k = 0; k < p; k++) {
        total += weight[k];
        right += weight[k] * (double)column[k];
        down += weight[k] * (double)row[k];
        lever += (double)(column[k] * column[k]); /* along both axes alike */
    }
    total /= (double)p, right /= lever, down /= lever;
#pragma omp simd
    for (int64_t k = 0; k < p; k++)
        weight[k] -= total + right * (double)column[k] + down * (double)row[k];
}

/* Take planes off a spot's weights (2, p), and fill in those of its bytes (2, p, channels), px/DN. */
static void spread_weights(const Fits *fits, int64_t n, int64_t channels, double *weight,
                           double *spread)
{
    int64_t p = pixels_of(fits, n);
    double channel[3] = {1.0};
    if (channels > 1)
        channel_weights(fits->colour + 3 * n, channel);
    for (int i = 0; i < 2; i++)
        leave_planes(p, rows_of(fits, n), weight + i * p);
    for (int64_t k = 0; k < 2 * p; k++)
        for (int64_t c = 0; c < channels; c++)
            spread[channels * k + c] = channel[c] * weight[k];
}

/* Copy the bytes of a patch (p, channels) about a pixel (x, y): a disc, row by row. */
static void read_patch(const Picture *picture, int64_t x, int64_t y, int64_t p, const float *rows,
                       uint8_t *bytes)
{
    const float *column = rows + ROW_COLUMN * p, *row = rows + ROW_ROW * p;
    for (int64_t begin = 0, n; begin < p; begin += n) {
        int64_t left = (int64_t)column[begin], line = y + (int64_t)row[begin];
        n = 1 - 2 * left;
        memcpy(bytes + picture->channels * begin,
               picture->values + picture->channels * (picture->width * line + x + left),
               (size_t)(picture->channels * n));
    }
}

/* Sum of n bytes, each times its weight. */
static double weigh(int64_t n, const uint8_t *bytes, const double *weight)
{
    double sum = 0.0;
#pragma omp simd reduction(+ : sum)
    for (int64_t k = 0; k < n; k++)
        sum += (double)bytes[k] * weight[k];
    return sum;
}

/* Whether a patch about a pixel (x, y) is inside the picture, and reached by no light but such as
 * are dim, below `bright`, DN; `dim`, filled: whether by one of those. */
static bool is_clear(const Surroundings *around, int64_t x, int64_t y, int64_t radius, double bright,
                     bool *dim)
{
    const Picture *picture = around->picture;
    *dim = false;
    if (x < radius || x >= picture->width - radius || y < radius || y >= picture->height - radius)
        return false;
    for (int64_t k = 0; k < around->n; k++) {
        const double *light = around->lights + 4 * k;
        double reach = (double)radius + PATCH_REACH * light[2];
        if (square((double)x - light[0]) + square((double)y - light[1]) <= square(reach)) {
            *dim = true;
            if (!(light[3] < bright))
                return false;
        }
    }
    return true;
}

/* Say what patches of the room beside so many spots would move the centre of spot n by. */
static void look_around(const Surroundings *around, const Fits *fits, int64_t n, int64_t spots,
                        const int64_t *beside, Response *response)
{
    Mark mark = scratch_mark();
    const Picture *picture = around->picture;
    const float *rows = rows_of(fits, n);
    int64_t p = pixels_of(fits, n), size = picture->channels * p;
    int64_t radius = -(int64_t)rows[ROW_ROW * p]; /* the topmost pixel comes first */
    double peak = fits->parameters[N_PARAMETERS * n + PAR_PEAK];
    double bright = MAX_DIM * MIN(peak, (double)SENSOR_LIMIT), away = 2.0 * (double)radius;
    double *spread = TAKE(double, 2 * size);
    uint8_t *bytes = TAKE(uint8_t, size);
    spread_weights(fits, n, picture->channels, response->weight, spread);
    for (int at = 0; at < N_BESIDE; at++) {
        double turn = (at % N_AROUND) * EIGHTH_TURN;
        bool clear = at / N_AROUND < spots;
        if (clear) {
            const int64_t *origin = fits->origin + 2 * beside[at / N_AROUND];
            int64_t x = origin[0] + (int64_t)floor(away * cos(turn) + 0.5);
            int64_t y = origin[1] + (int64_t)floor(away * sin(turn) + 0.5);
            clear = is_clear(around, x, y, radius, bright, response->dim + at);
            if (clear)
                read_patch(picture, x, y, p, rows, bytes);
        }
        for (int i = 0; i < 2; i++)
            response->moved[at][i] = clear ? weigh(size, bytes, spread + i * size) : NAN;
    }
    scratch_release(mark);
}

/* List the squares of what patches move a spot over what is explained; those that a dim light
 * reaches only if wanted. Gives how many. */
static int64_t list_ratios(const Response *response, int sides, bool dim, double *ratio)
{
    int64_t count = 0;
    for (int at = 0; at < 2 * sides; at++) {
        int side = at / 2, i = at % 2;
        double one = square(response->moved[side][i]) / response->explained[i];
        if (response->explained[i] > 0.0 && one >= 0.0 && (dim || !response->dim[side]))
            ratio[count++] = one;
    }
    return count;
}

/* How much more than explained the patches beside a spot itself, those that no light reaches, move it
 * on average; 0 without any. */
static double own_ratio(const Response *response)
{
    double ratio[2 * N_AROUND], total = 0.0;
    int64_t count = list_ratios(response, N_AROUND, false, ratio);
    for (int64_t k = 0; k < count; k++)
        total += ratio[k];
    return count > 0 ? total / (double)count : 0.0;
}

/* How much more than explained the room moves a spot; `picture`, all spots of the picture.
 *
 * Patches that a dim light reaches are texture where it leaves too few others: what is left beside
 * dim lights says it less well. Where both are too few, the whole picture tells. */
static double room_ratio(const Response *response, double picture)
{
    double ratio[2 * N_BESIDE];
    int64_t count = list_ratios(response, N_BESIDE, false, ratio);
    bool dim = count < MIN_AROUND;
    if (dim)
        count = list_ratios(response, N_BESIDE, true, ratio);
    double usual = count < MIN_AROUND ? picture : median(ratio, count) / MEDIAN_CHI2;
    double own = dim ? 0.0 : own_ratio(response);
    return own > MAX_OWN * MAX(usual, 1.0) ? own : usual;
}

void find_excess(const Surroundings *around, const Fits *fits, int64_t m, const int64_t *kept,
                 Response *responses, double *excess)
{
    Mark mark = scratch_mark();
    double *pool = TAKE(double, 2 * N_BESIDE * m);
    int64_t beside[N_PLACES], count = 0, spots = MIN(m, N_PLACES);
    for (int64_t k = 0; k < m; k++) {
        for (int64_t place = 0; place < spots; place++)
            beside[place] = kept[(k + place) % m];
        if (responses[k].weight != NULL)
            look_around(around, fits, kept[k], spots, beside, responses + k);
        count += list_ratios(responses + k, N_BESIDE, true, pool + count);
    }
    double ratio = count < MIN_AROUND ? around->noise_left : median(pool, count) / MEDIAN_CHI2;
    for (int64_t k = 0; k < m; k++)
        excess[k] = MAX(room_ratio(responses + k, ratio) - around->noise_left, 0.0);
    scratch_release(mark);
}
