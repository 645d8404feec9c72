#include "verify/measurement/detection/kernels/surroundings.h"

#include <math.h>

#include "verify/core/kernels/linear_algebra.h"
#include "verify/core/kernels/scratch.h"
#include "verify/measurement/detection/kernels/fit.h"

#define MIN_AROUND 12 /* responses, two a patch: fewer show nothing */
#define MAX_DIM 0.5   /* of a spot's peak: a light that is less may be texture of the room */
#define MAX_OWN 3.0   /* of the usual: a spot's own surroundings move it more than chance */
/* Of chi^2 with one degree of freedom, the part of the mean that the lowest three quarters make up, and
 * the efficiency of a variance by them against one by all. */
#define LOWER_PART 0.27638
#define EFFICIENCY 0.5627
#define DIAGONAL 0.7071067811865476

/* From a spot to the patches about it. */
static const double DIRECTIONS[N_AROUND][2] = {
    {1.0, 0.0}, {DIAGONAL, DIAGONAL}, {0.0, 1.0}, {-DIAGONAL, DIAGONAL},
    {-1.0, 0.0}, {-DIAGONAL, -DIAGONAL}, {0.0, -1.0}, {DIAGONAL, -DIAGONAL},
};

/* Patches of the room about a spot, the last ones that were read. */
typedef struct {
    int64_t spot, p;       /* number of the spot, of the fits; pixels of each patch */
    double weight[3];      /* of the channels */
    float *values;         /* (8, p), DN; 0 where a patch is not inside the picture */
    bool inside[N_AROUND]; /* which of them are */
    int64_t centre[N_AROUND][2]; /* px, their centre pixels */
} Patches;

/* Take mean and slopes off the weights (p,) of a disc's pixels: planes move nothing then. */
static void leave_planes(int64_t p, const float *rows, float *restrict weight)
{
    const float *restrict column = rows + ROW_COLUMN * pitch(p);
    const float *restrict row = rows + ROW_ROW * pitch(p);
    float total = 0.0f, right = 0.0f, down = 0.0f, lever = 0.0f;
#pragma omp simd reduction(+ : total, right, down, lever)
    for (int64_t k = 0; k < p; k++) {
        total += weight[k];
        right += weight[k] * column[k];
        down += weight[k] * row[k];
        lever += column[k] * column[k]; /* along both axes alike */
    }
    total /= (float)p, right /= lever, down /= lever;
#pragma omp simd
    for (int64_t k = 0; k < p; k++)
        weight[k] -= total + right * column[k] + down * row[k];
}

/* Read a patch (p,) about a pixel (x, y), DN, colours combined as the spot's: a disc, row by row.
 *
 * `weight` (3,): of each of the picture's channels; `bytes` (channels, p), scratch. */
static void read_patch(const Picture *picture, int64_t x, int64_t y, int64_t p, const float *rows,
                       const double *weight, uint8_t *restrict bytes, float *restrict value)
{
    const float *column = rows + ROW_COLUMN * pitch(p), *row = rows + ROW_ROW * pitch(p);
    int64_t channels = picture->channels;
    for (int64_t begin = 0, n; begin < p; begin += n) {
        int64_t left = (int64_t)column[begin], line = y + (int64_t)row[begin];
        n = 1 - 2 * left;
        memcpy(bytes + channels * begin,
               picture->values + channels * (picture->width * line + x + left),
               (size_t)(channels * n));
    }
    if (channels == 1) {
        for (int64_t k = 0; k < p; k++)
            value[k] = (float)bytes[k];
        return;
    }
    float blue = (float)weight[0], green = (float)weight[1], red = (float)weight[2];
    for (int64_t k = 0; k < p; k++)
        value[k] = blue * bytes[3 * k] + green * bytes[3 * k + 1] + red * bytes[3 * k + 2];
}

/* Whether a patch about a pixel (x, y) is inside a picture. */
static bool is_inside(const Picture *picture, int64_t x, int64_t y, int64_t radius)
{
    return x >= radius && x < picture->width - radius && y >= radius && y < picture->height - radius;
}

/* Whether no light reaches a patch about a pixel (x, y) but such as are dim, below `bright`, DN;
 * `dim`, filled: whether one of those does. */
static bool is_clear(const Surroundings *around, int64_t x, int64_t y, int64_t radius, double bright,
                     bool *dim)
{
    *dim = false;
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

/* Read the patches about a spot, as large as those of spot n and with its colours, unless they were
 * the last ones read there. */
static void read_patches(const Picture *picture, const Fits *fits, int64_t n, int64_t spot,
                         Patches *patches)
{
    int64_t p = pixels_of(fits, n), radius = fits->radius[n];
    const double *weight = fits->weight + 3 * n;
    if (patches->spot == spot && patches->p == p &&
        memcmp(patches->weight, weight, sizeof patches->weight) == 0)
        return;
    Mark mark = scratch_mark();
    uint8_t *bytes = TAKE(uint8_t, picture->channels * p);
    patches->spot = spot;
    patches->p = p;
    copy(patches->weight, weight, 3);
    for (int at = 0; at < N_AROUND; at++) {
        float *value = patches->values + at * pitch(p);
        int64_t *centre = patches->centre[at];
        for (int axis = 0; axis < 2; axis++)
            centre[axis] = fits->origin[2 * spot + axis]
                           + (int64_t)floor(2.0 * (double)radius * DIRECTIONS[at][axis] + 0.5);
        patches->inside[at] = is_inside(picture, centre[0], centre[1], radius);
        if (patches->inside[at])
            read_patch(picture, centre[0], centre[1], p, rows_of(fits, n), weight, bytes, value);
        else
            memset(value, 0, sizeof(float) * (size_t)p);
        clear_behind(p, value);
    }
    scratch_release(mark);
}

/* Say what the patches about a spot would move the centre of spot n by; `place`, of that spot among
 * those beside. */
static void weigh_patches(const Surroundings *around, const Fits *fits, int64_t n, int64_t place,
                          const Patches *patches, Response *response)
{
    int64_t radius = fits->radius[n];
    double peak = fits->parameters[N_PARAMETERS * n + PAR_PEAK], moved[2][N_AROUND];
    double bright = MAX_DIM * MIN(peak, (double)SENSOR_LIMIT);
    multiply_rows(2, N_AROUND, patches->p, response->weight, patches->values, false, moved[0]);
    for (int at = 0; at < N_AROUND; at++) {
        bool *dim = response->dim + N_AROUND * place + at;
        double *found = response->moved[N_AROUND * place + at];
        const int64_t *centre = patches->centre[at];
        if (patches->inside[at] && is_clear(around, centre[0], centre[1], radius, bright, dim))
            found[0] = moved[0][at], found[1] = moved[1][at];
    }
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

/* Variance that squares (n,) show; up to a quarter may be of patches with something bright. */
static double trimmed_mean(const double *ratio, int64_t n)
{
    double most = select_rank(ratio, n, 3 * n / 4), total = 0.0;
    for (int64_t k = 0; k < n; k++)
        total += ratio[k] < most ? ratio[k] : 0.0;
    return total / (LOWER_PART * (double)n);
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

/* How much more than explained and than noise, `left`, the room moves a spot; `picture`, all spots of
 * the picture.
 *
 * Patches that a dim light reaches are texture where it leaves too few others: what is left beside
 * dim lights says it less well. Where both are too few, the whole picture tells. What few patches
 * show may by chance be too little: the mean of what it may be counts (JCGM 101:2008, 6.4.9). */
static double room_excess(const Response *response, double picture, double left)
{
    double ratio[2 * N_BESIDE];
    int64_t count = list_ratios(response, N_BESIDE, false, ratio);
    bool dim = count < MIN_AROUND;
    if (dim)
        count = list_ratios(response, N_BESIDE, true, ratio);
    double usual = count < MIN_AROUND ? picture : trimmed_mean(ratio, count);
    double own = dim ? 0.0 : own_ratio(response), freedom = EFFICIENCY * MAX(count, MIN_AROUND);
    if (own > MAX_OWN * MAX(usual, 1.0))
        return own - left;
    return MAX(usual - left, 0.0) * freedom / (freedom - 2.0);
}

/* Say what patches beside spot k of those kept, and beside some others, would move its centre by. */
static void look_around(const Surroundings *around, const Fits *fits, int64_t m, const int64_t *kept,
                        int64_t k, Patches *beside, Response *response)
{
    int64_t n = kept[k], p = pixels_of(fits, n);
    for (int i = 0; i < 2; i++)
        leave_planes(p, rows_of(fits, n), response->weight + i * pitch(p));
    for (int64_t place = 0; place < MIN(m, N_PLACES); place++) {
        int64_t other = (k + place) % m;
        Patches *patches = beside + other % N_PLACES;
        read_patches(around->picture, fits, n, kept[other], patches);
        weigh_patches(around, fits, n, place, patches, response);
    }
}

void find_excess(const Surroundings *around, const Fits *fits, int64_t m, const int64_t *kept,
                 Response *responses, double *excess)
{
    Mark mark = scratch_mark();
    double *pool = TAKE(double, 2 * N_BESIDE * m);
    int64_t count = 0, largest = 0;
    Patches beside[N_PLACES];
    for (int64_t k = 0; k < m; k++)
        largest = MAX(largest, pixels_of(fits, kept[k]));
    for (int place = 0; place < N_PLACES; place++)
        beside[place] = (Patches){.spot = -1, .values = TAKE(float, N_AROUND * pitch(largest))};
    for (int64_t k = 0; k < m; k++) {
        for (int at = 0; at < N_BESIDE; at++)
            responses[k].moved[at][0] = responses[k].moved[at][1] = NAN;
        if (responses[k].weight != NULL)
            look_around(around, fits, m, kept, k, beside, responses + k);
        count += list_ratios(responses + k, N_BESIDE, true, pool + count);
    }
    double ratio = count < MIN_AROUND ? around->noise_left : trimmed_mean(pool, count);
    for (int64_t k = 0; k < m; k++)
        excess[k] = room_excess(responses + k, ratio, around->noise_left);
    scratch_release(mark);
}
