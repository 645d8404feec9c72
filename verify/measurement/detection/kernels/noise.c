/* Estimate an image's noise from its background.
 *
 * Of five pixels a to e of a row a local cubic leaves the fourth difference a - 4 b + 6 c - 4 d
 * + e, whose variance is 70 times a pixel's; within classes of brightness its median bounds what
 * belongs to the background, and the quietest class shows read.
 */
#include "verify/measurement/detection/kernels/noise.h"

#include "verify/core/kernels/linear_algebra.h"
#include "verify/core/kernels/scratch.h"

/* levels are whole thirty-fifths, differences whole: both can be counted */
#define LEVEL_PARTS 35 /* a level's, of one DN */
#define LOWEST_LEVEL (6 * 255)
#define N_LEVELS (50 * 255 + 1)
#define N_DIFFERENCES 1024 /* the last stands for larger ones too: of a texture, not of noise */
#define BLOCK_PIXELS 64    /* pixels in a row that are looked at, or left out, together */
/* Fourth difference along a line: cubic shading vanishes; white noise of variance v leaves 70 v.
 * The level beside it is a local cubic's, which has no bias. */
#define STENCIL_GAIN 70.0
#define MAD_OVER_SIGMA 0.67449 /* median of |x| over sigma, Gaussian */
#define TRIM_SIGMA 3.0         /* sigma; the variance within is TRIMMED_VARIANCE of the whole */
#define TRIMMED_VARIANCE 0.9733
#define MIN_ABOVE_BLACK 5 /* DN above the limit of black: nearer, clipping narrows the noise */
#define CLASS_WIDTH 12    /* DN, width of a level class */
#define N_CLASSES ((256 - MIN_ABOVE_BLACK + CLASS_WIDTH - 1) / CLASS_WIDTH)
#define FIRST_LEVEL (LOWEST_LEVEL + LEVEL_PARTS * MIN_ABOVE_BLACK)
#define CLASS_PARTS (LEVEL_PARTS * CLASS_WIDTH)
#define BLACK_SHARE 0.01      /* share of a picture that is no brighter than black */
#define MIN_STENCILS 60       /* stencils a level class must hold: 15 % on its variance */
#define N_SAMPLE_ROWS 24     /* rows sampled */
#define N_SAMPLE 10000       /* pixels of them at least: read noise to 2 %, TEXTURE_SHARE / 5 */
#define TYPICAL_READ 1.5     /* DN, where no unclipped dark pixel shows it */
#define TEXTURE_SHARE 0.1    /* relative: what unseen texture may add to the dark variance */

/* Rows of pixels of one channel, DN; steps to the next row and the next pixel. */
typedef struct {
    const uint8_t *values;
    int64_t count, width, row_step, step;
} Sample;

/* Least dark variance, DN^2, nan where no class has members enough; its relative spread; what share
 * of the pixels is not clipped; the black level, DN, 0 where that is less than half. */
typedef struct {
    double dark, spread, unclipped, black;
} Background;

/* Count a block's levels and differences, as `count_stencils` does; `row` (count + 4,), DN. */
static void count_block(const int16_t *row, int64_t count, int32_t *levels, int32_t *differences)
{
    int16_t level[BLOCK_PIXELS], difference[BLOCK_PIXELS];
    uint16_t part[BLOCK_PIXELS];
    bool clean[BLOCK_PIXELS];
    for (int64_t k = 0; k < count; k++) {
        bool inside = true;
        for (int64_t i = k; i < k + 5; i++)
            inside &= (row[i] > 0) & (row[i] < 255);
        clean[k] = inside;
    }
    for (int64_t k = 0; k < count; k++) {
        int16_t ends = row[k] + row[k + 4], sides = row[k + 1] + row[k + 3], middle = row[k + 2];
        int16_t size = ends - 4 * sides + 6 * middle;
        size = size < 0 ? -size : size;
        level[k] = LOWEST_LEVEL - 3 * ends + 12 * sides + 17 * middle;
        difference[k] = MIN(size, N_DIFFERENCES - 1);
        /* what is below the first class wraps to far above the last one */
        part[k] = (uint16_t)(level[k] - FIRST_LEVEL) / CLASS_PARTS;
    }
    for (int64_t k = 0; k < count; k++)
        if (clean[k]) {
            levels[level[k]]++;
            if (part[k] < N_CLASSES)
                differences[part[k] * N_DIFFERENCES + difference[k]]++;
        }
}

/* Count levels and fourth differences of five neighbours in a row, wherever nothing is clipped.
 *
 * Of `sample` one block of BLOCK_PIXELS in each `apart` is looked at. Filled: `levels`
 * (N_LEVELS,), of the local cubic's value, in parts; `differences` (N_CLASSES, N_DIFFERENCES), of
 * their size, DN, by classes of brightness. Gives how many pixels were looked at. */
static int64_t count_stencils(const Sample *sample, int64_t apart, int32_t *levels,
                              int32_t *differences)
{
    int64_t looked = 0, places = sample->width - 4, step = sample->step;
    int16_t row[BLOCK_PIXELS + 4];
    for (int64_t r = 0; r < sample->count; r++)
        for (int64_t begin = r % apart * BLOCK_PIXELS; begin < places;
             begin += apart * BLOCK_PIXELS) {
            int64_t count = MIN(BLOCK_PIXELS, places - begin);
            const uint8_t *values = sample->values + r * sample->row_step + begin * step;
            for (int64_t k = 0; k < count + 4; k++)
                row[k] = values[k * step];
            count_block(row, count, levels, differences);
            looked += count;
        }
    return looked;
}

/* A quantile of counted whole numbers, from 0 on, interpolated as numpy does; `number`, one at
 * least: how many there are in all. */
static double counts_quantile(const int32_t *counts, int64_t number, double share)
{
    double place = share * (double)(number - 1), low = floor(place);
    double first = (double)ranked(counts, (int64_t)low);
    double second = (double)ranked(counts, MIN((int64_t)low + 1, number - 1));
    return first + (second - first) * (place - low);
}

/* Let a class of brightness say what the dark variance is, if this is less, its uncertainty
 * included, than `best`, which is changed then. */
static void judge_class(int part, const int32_t *levels, const int32_t *differences, double *best,
                        Background *background)
{
    int64_t members = 0, total = 0, squares = 0, count = 0;
    int64_t first = FIRST_LEVEL + part * CLASS_PARTS;
    for (int64_t level = first; level < MIN(first + CLASS_PARTS, N_LEVELS); level++) {
        members += levels[level];
        total += levels[level] * (level - LOWEST_LEVEL);
    }
    if (members < MIN_STENCILS)
        return;
    double middle = counts_quantile(differences, members, 0.5);
    int64_t most = (int64_t)(TRIM_SIGMA * MAX(middle / MAD_OVER_SIGMA, 1.0));
    for (int64_t size = 0; size < MIN(most + 1, N_DIFFERENCES); size++) {
        squares += differences[size] * size * size;
        count += differences[size];
    }
    double variance = (double)squares / (double)count / TRIMMED_VARIANCE / STENCIL_GAIN;
    double mean = (double)total / (double)members / LEVEL_PARTS;
    double dark = variance - TYPICAL_GAIN * (mean - background->black);
    double relative = sqrt(2.0 / (INDEPENDENT_SHARE * (double)count));
    double most_dark = dark + 2.0 * relative * variance;
    if (most_dark < *best) {
        *best = most_dark;
        background->dark = dark;
        background->spread = relative;
    }
}

/* Find the class of brightness whose dark variance is least, its uncertainty included.
 *
 * `apart` as for `count_stencils`; of a `lossy` image only black is found. */
static Background dark_variance(const Sample *sample, int64_t apart, bool lossy)
{
    Mark mark = scratch_mark();
    Background background = {.dark = NAN, .spread = 0.0, .black = 0.0};
    int64_t clean = 0;
    double best = INFINITY;
    int32_t *levels = TAKE(int32_t, N_LEVELS);
    int32_t *differences = TAKE(int32_t, N_CLASSES * N_DIFFERENCES);
    memset(levels, 0, sizeof(int32_t) * N_LEVELS);
    memset(differences, 0, sizeof(int32_t) * N_CLASSES * N_DIFFERENCES);
    int64_t looked = count_stencils(sample, apart, levels, differences);
    for (int64_t level = 0; level < N_LEVELS; level++)
        clean += levels[level];
    background.unclipped = (double)clean / (double)MAX(looked, 1);
    if (2 * clean > looked) {
        double level = counts_quantile(levels, clean, BLACK_SHARE);
        background.black = (level - LOWEST_LEVEL) / LEVEL_PARTS;
    }
    for (int part = 0; part < (lossy ? 0 : N_CLASSES); part++)
        judge_class(part, levels, differences + part * N_DIFFERENCES, &best, &background);
    scratch_release(mark);
    return background;
}

/* Of BGR the green channel stands for all. Texture only ever adds to differences, so the quietest
 * class of brightness is believed; of a JPEG, which smooths what is dark, none. */
void background_noise(const Picture *picture, bool lossy, double *noise)
{
    int64_t width = picture->width, height = picture->height, channels = picture->channels;
    int64_t every = MAX(height / N_SAMPLE_ROWS, 1), count = (height + every - 1) / every;
    Sample sample = {picture->values + channels / 2, count, width, every * width * channels,
                     channels};
    Background found = dark_variance(&sample, MAX(count * width / N_SAMPLE, 1), lossy);
    /* nothing unclipped, or what is not black here may be all texture */
    bool hidden = !isfinite(found.dark) ||
                  (found.unclipped <= 0.5 && found.dark > TYPICAL_READ * TYPICAL_READ);
    noise[0] = lossy || hidden ? TYPICAL_READ * TYPICAL_READ : MAX(found.dark, QUANTISATION);
    noise[1] = TYPICAL_GAIN;
    noise[2] = hidden && !lossy ? 0.0 : found.black;
    noise[3] = lossy || hidden ? TYPICAL_SPREAD : found.spread + TEXTURE_SHARE;
}

/* For tests. `rows` (r, w); the counts are added to. */
int64_t entry_count_stencils(int64_t r, int64_t w, const uint8_t *rows, int64_t apart,
                             int32_t *levels, int32_t *differences)
{
    Sample sample = {rows, r, w, w, 1};
    return count_stencils(&sample, apart, levels, differences);
}
