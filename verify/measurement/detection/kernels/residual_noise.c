/* Estimate an image's noise from the residuals of its spots, as the background leaves it.
 *
 * Squared second differences d of a spot's residuals along a row, which texture of the room hardly
 * changes, follow
 *
 *     E[d^2] = left (dark + gain signal), weighed by 1 / (2 (dark + gain signal)^2)
 *
 *     symbol  meaning                                                         unit
 *     dark    variance without light                                          DN^2
 *     gain    variance a unit of signal                                       DN
 *     left    share of the variance that the fit's own parameters leave       1
 *
 * Where the background shows no noise, in a JPEG, which smooths differences, or below black, where no
 * texture shows, d is the residual itself.
 */
#include "verify/measurement/detection/kernels/residual_noise.h"

#include "verify/core/kernels/linear_algebra.h"
#include "verify/core/kernels/scratch.h"
#include "verify/measurement/detection/kernels/noise.h"
#include "verify/measurement/detection/kernels/quality.h"

#define MAX_NOISE_SPOTS 8    /* whose residuals show the noise, brightest first: then come glints */
#define MIN_PIXELS 32        /* pixels: of fewer, the fit's own parameters take more than a quarter */
#define CORE_AREA 1.77       /* of a spot's core over its square diameter, as in fit.c */
/* Share of its core that clipping must leave: a spot farther over the limit shows its core's shape so
 * little that what does not fit there would pass for gain. */
#define MIN_CLEAR 0.33
#define MAX_MISFIT_RATIO 1.7 /* times the best misfit: more is a shape that the profiles lack */
#define MAX_SHAPE_SIGMA 3.0  /* standard deviations of a misfit of so few pixels */
#define SECOND_SIDE 0.40824829f /* of a second difference's ends, its squares' sum being 1 */
#define MIN_LEFT 0.2f           /* share of a difference's variance that the fit must leave */
#define MIN_GAIN 1e-4        /* DN, 2.5 million electrons: no sensor holds more */
#define MAX_GAIN 0.2         /* DN, 1,300 electrons: above, it is the shape that does not fit */

/* Fill in what share of the variance of differences of three neighbouring pixels, (p,), a spot's fit
 * leaves: pixel by pixel from `first` to `last`, 1 elsewhere.
 *
 * A difference is the middle pixel times `middle` and both others times `side`. With q its derivatives by
 * the parameters and A their information, the fit takes q A^-1 q of its variance. */
static void variance_left(const Fits *fits, int64_t n, float side, float middle, int64_t first,
                          int64_t last, float *restrict left)
{
    Mark mark = scratch_mark();
    int64_t p = pixels_of(fits, n);
    const double *root = fits->root + N_PARAMETERS * N_PARAMETERS * n;
    const float *rows = rows_of(fits, n), *variance = rows + ROW_VARIANCE * pitch(p);
    float *restrict sigma = TAKE(float, p), *solved = TAKE(float, N_PARAMETERS * p);
    for (int64_t k = first - 1; k <= last + 1; k++)
        sigma[k] = sqrtf(variance[k]);
    for (int64_t k = 0; k < p; k++)
        left[k] = k < first || k > last ? 1.0f : 0.0f;
    for (int a = 0; a < N_PARAMETERS; a++) {
        const float *restrict by = rows + a * pitch(p);
        float *restrict own = solved + a * p;
        float inverse = (float)(1.0 / root[a * N_PARAMETERS + a]);
        for (int64_t k = first; k <= last; k++)
            own[k] = middle * by[k] * sigma[k] +
                     side * (by[k - 1] * sigma[k - 1] + by[k + 1] * sigma[k + 1]);
        for (int b = 0; b < a; b++) {
            const float *restrict other = solved + b * p;
            float share = (float)root[a * N_PARAMETERS + b];
            for (int64_t k = first; k <= last; k++)
                own[k] -= share * other[k];
        }
        for (int64_t k = first; k <= last; k++) {
            own[k] *= inverse;
            left[k] -= own[k] * own[k];
        }
    }
    for (int64_t k = first; k <= last; k++) {
        float beside = variance[k - 1] + variance[k + 1];
        left[k] = 1.0f + left[k] / (middle * middle * variance[k] + side * side * beside);
    }
    scratch_release(mark);
}

/* Gather squared differences of residuals, DN^2, and signals, DN above black, of a spot's unclipped
 * pixels.
 *
 * Of three neighbours in a row the second difference leaves out texture; with `second` false the
 * residual itself counts. `residual2` and `signal` are filled from the first on. Gives how many are
 * filled in. */
static int64_t gather_residuals(const Fits *fits, int64_t n, bool second, double *residual2,
                                double *signal)
{
    Mark mark = scratch_mark();
    int64_t p = pixels_of(fits, n), count = 0, first = 1, last = p - 2;
    const float *rows = rows_of(fits, n), *used = rows + ROW_USED * pitch(p);
    const float *visible = rows + ROW_VISIBLE * pitch(p), *value = rows + ROW_VALUE * pitch(p);
    const float *mean = rows + ROW_MEAN * pitch(p), *above = rows + ROW_SIGNAL * pitch(p);
    const float *row = rows + ROW_ROW * pitch(p), *core = rows + ROW_CORE * pitch(p);
    const double *share = fits->share + 2 * n;
    float side = second ? -SECOND_SIDE : 0.0f, middle = second ? 2.0f * SECOND_SIDE : 1.0f;
    float *off = TAKE(float, p), *left = TAKE(float, p);
    bool *clear = TAKE(bool, p);
    while (first < last && !(core[first] > 0.0f))
        first++;
    while (first < last && !(core[last] > 0.0f))
        last--;
    variance_left(fits, n, side, middle, first, last, left);
    for (int64_t k = 0; k < p; k++) {
        off[k] = value[k] - mean[k];
        clear[k] = (used[k] > 0.0f) & (visible[k] > MIN_NOISE_SHARE);
    }
    for (int64_t k = 1; k < p - 1; k++) {
        float one = middle * off[k] + side * (off[k - 1] + off[k + 1]);
        float light = middle * middle * above[k] + side * side * (above[k - 1] + above[k + 1]);
        bool beside = (row[k - 1] == row[k + 1]) & clear[k - 1] & clear[k + 1];
        /* combined colours have a noise of their own; brought back to that of one channel */
        residual2[count] = (double)(one * one / left[k]) / share[0];
        signal[count] = (double)light * share[1] / share[0];
        count += clear[k] & (beside | !second) & (left[k] > MIN_LEFT);
    }
    scratch_release(mark);
    return count;
}

/* Least misfit of n spots, those of few pixels left out unless there is no other. */
static double least_misfit(int64_t n, const double *misfit, const int64_t *begin)
{
    double least = INFINITY, of_many = INFINITY;
    for (int64_t k = 0; k < n; k++) {
        bool many = begin[k + 1] - begin[k] >= MIN_PIXELS;
        least = misfit[k] < least ? misfit[k] : least;
        of_many = many && misfit[k] < of_many ? misfit[k] : of_many;
    }
    return of_many < INFINITY ? of_many : least;
}

/* Mean of squared residuals (p,) over the variance that a line, dark and gain, has for them. */
static double misfit_of(int64_t p, const double *residual2, const double *signal, double dark,
                        double gain)
{
    double total = 0.0;
    #pragma omp simd reduction(+ : total)
    for (int64_t k = 0; k < p; k++)
        total += residual2[k] / (dark + gain * signal[k]);
    return total / (double)p;
}

/* Regress squared residuals (k,), DN^2, on signal (k,), DN, misfitting spots left out.
 *
 * `begin` (n + 1,): where each of n spots' pixels begin; `line` (2,), changed: dark variance and
 * gain, the start; `usual` (2,): one over their standard uncertainties. */
static void variance_line(int64_t n, const double *residual2, const double *signal,
                          const int64_t *begin, double *line, const double *usual)
{
    Mark mark = scratch_mark();
    double first0 = line[0], first1 = line[1], *misfit = TAKE(double, n);
    for (int turn = 0; turn < 3; turn++) { /* which spots are clean settles in two rounds */
        double dark = line[0], gain = line[1];
        for (int64_t m = 0; m < n; m++)
            misfit[m] = misfit_of(begin[m + 1] - begin[m], residual2 + begin[m],
                                  signal + begin[m], dark, gain);
        double most = MAX_MISFIT_RATIO * least_misfit(n, misfit, begin);
        double a = square(usual[0]), b = 0.0, d = square(usual[1]);
        double u = a * first0, v = d * first1;
        for (int64_t m = 0; m < n; m++) {
            if (misfit[m] > most)
                continue;
            #pragma omp simd reduction(+ : a, b, d, u, v)
            for (int64_t k = begin[m]; k < begin[m + 1]; k++) {
                double weight = 0.5 * square(1.0 / (dark + gain * signal[k]));
                double tilted = weight * signal[k];
                a += weight;
                b += tilted;
                d += tilted * signal[k];
                u += weight * residual2[k];
                v += tilted * residual2[k];
            }
        }
        double determinant = a * d - b * b;
        line[0] = MAX((d * u - b * v) / determinant, QUANTISATION);
        line[1] = MIN(MAX((a * v - b * u) / determinant, MIN_GAIN), MAX_GAIN);
    }
    scratch_release(mark);
}

/* Whether enough of a spot's own pixels (18,) show the noise: none but what clipping leaves alone. */
static bool shows_noise(const double *row)
{
    double core = CORE_AREA * square(row[COL_DIAMETER]);
    return row[COL_SOUND] > 0.0 && row[COL_COUNT] > MAX(2.0 * N_FITTED, MIN_CLEAR * core);
}

/* List the brightest of n spots that show the noise and whose shape is that of an LED; `shows` (n,) is
 * filled with as many as it gives. */
static int64_t noise_spots(int64_t n, const double *assessed, int64_t *shows)
{
    Mark mark = scratch_mark();
    double *rank = TAKE(double, n), least = INFINITY;
    int64_t count = 0;
    for (int64_t k = 0; k < n; k++) {
        const double *row = assessed + N_COLUMNS * k;
        rank[k] = -row[COL_PEAK] / row[COL_ELONGATION];
        least = shows_noise(row) ? MIN(least, row[COL_SHAPE]) : least;
    }
    for (int64_t k = 0; k < n; k++) {
        const double *row = assessed + N_COLUMNS * k;
        double chance = 1.0 + MAX_SHAPE_SIGMA * sqrt(2.0 / MAX(row[COL_COUNT], 1.0));
        if (shows_noise(row) && row[COL_SHAPE] <= MAX_MISFIT_RATIO * chance * least)
            shows[count++] = k;
    }
    scratch_release(mark);
    return first_by(rank, count, shows, MAX_NOISE_SPOTS);
}

/* Bright pixels show the gain: variance line by weighted regression of squared differences on signal;
 * misfitting spots left out. */
void refine_noise(const Fits *fits, const double *assessed, double *noise, double spread)
{
    Mark mark = scratch_mark();
    int64_t n = fits->n, begin[MAX_NOISE_SPOTS + 1] = {0}, *shows = TAKE(int64_t, n);
    int64_t count = noise_spots(n, assessed, shows);
    bool second = spread < TYPICAL_SPREAD;
    if (count > 0) {
        double *residual2 = TAKE(double, fits->begin[n]), *signal = TAKE(double, fits->begin[n]);
        for (int64_t m = 0; m < count; m++)
            begin[m + 1] = begin[m] + gather_residuals(fits, shows[m], second, residual2 + begin[m],
                                                       signal + begin[m]);
        double worth = sqrt(second ? INDEPENDENT_SHARE : 1.0);
        double usual[2] = {1.0 / (worth * spread * noise[0]),
                           1.0 / (worth * TYPICAL_SPREAD * TYPICAL_GAIN)};
        noise[1] = TYPICAL_GAIN;
        variance_line(count, residual2, signal, begin, noise, usual);
    }
    scratch_release(mark);
}

/* For tests. */
int64_t entry_variance_line(int64_t n, const double *residual2, const double *signal,
                            const int64_t *begin, double *line, const double *usual)
{
    GUARDED((variance_line(n, residual2, signal, begin, line, usual), 0));
}
