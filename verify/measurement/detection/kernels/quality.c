/* Judge fitted spots: centre and covariance, diameter, whether a spot has the shape of one LED.
 *
 * With misfit m the residuals' mean square over their variance, to which texture of the room is added,
 * the covariance is enlarged
 *
 *     by 1 + c max(m - 1 - MAX_CHI2_SIGMA sqrt(2 / freedom), 0),  of merged spots by c m,
 *        and STRETCH_SHARE stretch x diameter added (`doubt_shapes`)
 *
 * with c = CORRELATED_PIXELS; in a JPEG, where the misfit of clean spots, of noise alone, has the
 * median M, by
 *
 *     s M (1 + c max(m / M - MAX_LOSSY_MISFIT, 0)),  s = LOSSY_SHARE
 *
 * of clipped ones by s max(M, m / MAX_CLIPPED_MISFIT).
 *
 * Quantisation wipes out fine detail and so adds errors that are mostly even about a spot, or finer
 * than what a shift of its centre changes. s is measured: simulated spots of 4 to 14 px, quality 60
 * to 98, where +- 1.96 u so holds 94 to 97 %.
 */
#include "verify/measurement/detection/kernels/quality.h"

#include "verify/core/kernels/linear_algebra.h"
#include "verify/core/kernels/scratch.h"
#include "verify/measurement/detection/kernels/fit.h"

#define MAX_REDUCED_CHI2 6.0     /* reduced chi^2 of a shape that no clean LED has */
/* the same, over a patch, and of the limit, of a top that clipping hides: both, and texture about the
 * spot may have chosen its shape */
#define MAX_HIDDEN_CHI2 2.5
#define MAX_HIDDEN_PEAK 3.0
/* rms residual over peak; both must hold: a bright LED shows any flaw */
#define MAX_RESIDUAL_RATIO 0.035
#define MIN_PEAK 8.0             /* sigma of the peak: chance does not reach it in a picture */
#define MAX_SHIFT 1.5 /* half-widths: a fit that left its candidate has found something else */
#define MAX_AXIS_RATIO 2.0 /* of the fitted profile; a blurred LED stays below, streaks do not */
/* A shape that the profiles lack (a stalk before the LED, a reflection beside it) leaves errors
 * larger than noise, in neighbouring pixels alike: the covariance covers them too. What is left of
 * a clipped spot is too little to judge its shape by. */
#define MAX_CHI2_SIGMA 3.0   /* standard deviations of a reduced chi^2 that noise alone reaches */
#define LOSSY_SHARE 0.8      /* of a JPEG's squared errors, which move a centre */
#define MIN_LOSSY_MISFIT 0.5 /* noise is not estimated twice too large */
#define MAX_LOSSY_MISFIT 3.0 /* times the usual: more is a shape, not quantisation */
#define MAX_CLIPPED_MISFIT 2.0 /* of a clipped spot in a JPEG: more widens it by itself */
/* Light beside an LED, or an edge before it, stretches it alone, and motion all. Flat LEDs seen
 * from aside differ too, each by its angle, but are no longer than others, and the same on both
 * sides: chi^2 of a bite seldom exceeds 10 at any angle, and seldom stays below 15 behind one. */
#define MIN_ALIKE 3      /* spots: fewer do not show what is usual */
#define MAX_STRETCH 0.05 /* diameters */
#define MAX_LENGTH 1.2   /* of the longest width, over the usual one: alone */
#define MAX_SURE_LENGTH 1.04 /* the same, of what misfits */
#define MAX_LONGER_SIGMA 2.0 /* standard deviations of that misfit */
#define MAX_ASYMMETRY 12.0   /* chi^2 of a bite out of a stretched spot, over the usual misfit */
#define MIN_STRETCH_SIGMA 15.0 /* of the centre: noise stretches a spot by 2.4 to 3.4 of them */
/* Two equal lights d apart add d^2/4 to the second moment along their line, and their middle is
 * d/2 off: the widths give that as 0.36 stretch x diameter of Gaussians, 0.13 of discs; half an
 * axis. A blurred disc of which an edge leaves less than half is farther off: twice as much. */
#define STRETCH_SHARE 0.3
#define MIN_BORDER 1.2     /* half-widths that must be inside the image */
#define MIN_SEPARATION 0.5 /* diameters of the smaller one: closer spots are one spot found twice */
#define MAX_PART 0.75      /* of a disc's diameter: a smaller spot on it is a part of it */
#define MAX_PART_PEAK 1.5  /* of a disc's peak, that a part of it may seem to have */

static bool all_finite(int64_t n, const double *values)
{
    bool finite = true;
    for (int64_t k = 0; k < n; k++)
        finite = finite && isfinite(values[k]);
    return finite;
}

/* Fill in the information's factor `root` (10, 10), and the covariance of the centre, other parameters
 * free, px^2; NaN where it is not finite. */
static void centre_covariance(const double *information, double *root, double *row)
{
    double right[2][N_PARAMETERS] = {{0.0}};
    double unit = all_finite(N_PARAMETERS * N_PARAMETERS, information) ? 1.0 : NAN;
    factor(N_PARAMETERS, information, -MIN_INFORMATION, root);
    right[0][PAR_X] = right[1][PAR_Y] = unit;
    solve(N_PARAMETERS, root, right[0]);
    solve(N_PARAMETERS, root, right[1]);
    row[COL_COVARIANCE_XX] = right[0][PAR_X];
    row[COL_COVARIANCE_XY] = row[COL_COVARIANCE_YX] = right[0][PAR_Y];
    row[COL_COVARIANCE_YY] = right[1][PAR_Y];
}

/* Variance, DN^2, by which what is about a spot exceeds its noise: texture of the room. */
static double texture_variance(int64_t p, const float *rows)
{
    const float *used = rows + ROW_USED * pitch(p), *radius2 = rows + ROW_RADIUS2 * pitch(p);
    const float *value = rows + ROW_VALUE * pitch(p), *mean = rows + ROW_MEAN * pitch(p);
    const float *variance = rows + ROW_VARIANCE * pitch(p);
    float count = 0.0f, excess = 0.0f;
#pragma omp simd reduction(+ : count, excess)
    for (int64_t k = 0; k < pitch(p); k++) {
        float off = value[k] - mean[k];
        float one = radius2[k] > NEIGHBOUR_RADIUS * NEIGHBOUR_RADIUS ? used[k] : 0.0f;
        count += one;
        excess += one * (off * off - variance[k]);
    }
    return MAX((double)excess, 0.0) / MAX((double)count, 1.0);
}

/* Say how far the shape is that of one LED, and enlarge the covariance by what it is not.
 *
 * `pixels`, that misfit beyond chance lifts together; `texture`, DN^2, variance of the room, which
 * surroundings.c accounts for; `row` (18,), changed. A spot is judged by those of its own pixels that
 * clipping leaves alone; where they are too few, by all of its patch. */
static void assess_shape(const Fits *fits, int64_t n, double pixels, double texture, double *row)
{
    int64_t p = pixels_of(fits, n);
    const float *rows = rows_of(fits, n), *valid = rows + ROW_VALID * pitch(p);
    const float *core = rows + ROW_CORE * pitch(p), *visible = rows + ROW_VISIBLE * pitch(p);
    const float *value = rows + ROW_VALUE * pitch(p), *mean = rows + ROW_MEAN * pitch(p);
    const float *variance = rows + ROW_VARIANCE * pitch(p);
    float count = 0.0f, squares = 0.0f, square_dn = 0.0f, full = 0.0f, clear = 0.0f;
    float square_fair = 0.0f, room = (float)texture;
#pragma omp simd reduction(+ : count, squares, square_dn, full, clear, square_fair)
    for (int64_t k = 0; k < pitch(p); k++) {
        float alone = visible[k] > MIN_NOISE_SHARE ? core[k] : 0.0f, off = value[k] - mean[k];
        clear += visible[k] > MIN_NOISE_SHARE ? valid[k] : 0.0f;
        full += value[k] >= SENSOR_LIMIT ? core[k] : 0.0f;
        count += alone;
        squares += alone * off * off / variance[k];
        square_fair += alone * off * off / (variance[k] + room);
        square_dn += alone * off * off;
    }
    double freedom = (double)count - N_FITTED, paid = MAX(freedom, 1.0);
    double misfit = freedom >= N_FITTED ? (double)squares / paid : fits->chi2[n] / MAX(clear, 1.0);
    double shape = freedom >= N_FITTED ? (double)square_fair / paid : misfit;
    double rough = sqrt((double)square_dn / paid), peak = fits->parameters[N_PARAMETERS * n + PAR_PEAK];
    double limit = (double)SENSOR_LIMIT;
    bool merged = freedom < N_FITTED
                      ? misfit > MAX_HIDDEN_CHI2 && peak > MAX_HIDDEN_PEAK * limit
                      : shape > MAX_REDUCED_CHI2 && rough > MAX_RESIDUAL_RATIO * MIN(peak, limit);
    double beyond = shape - 1.0 - MAX_CHI2_SIGMA * sqrt(2.0 / paid);
    double excess = full == 0.0f ? MAX(beyond, 0.0) : 0.0;
    double larger = merged ? CORRELATED_PIXELS * misfit : 1.0 + pixels * excess;
    row[COL_NOISE] = (row[COL_COVARIANCE_XX] + row[COL_COVARIANCE_YY]) / 2.0;
    row[COL_NOISE] *= 1.0 + CORRELATED_PIXELS * (misfit - shape);
    for (int k = COL_COVARIANCE_XX; k <= COL_COVARIANCE_YY; k++)
        row[k] *= larger;
    row[COL_MISFIT] = misfit;
    row[COL_SHAPE] = shape;
    row[COL_COUNT] = (double)count;
    row[COL_SATURATED] = full > 0.0f ? 1.0 : 0.0;
    row[COL_MERGED] = merged ? 1.0 : 0.0;
}

void assess_all(const Fits *fits, int64_t width, int64_t height, double lifted, double *assessed)
{
    Mark mark = scratch_mark();
    double *texture = TAKE(double, fits->n);
    for (int64_t n = 0; n < fits->n; n++)
        texture[n] = texture_variance(pixels_of(fits, n), rows_of(fits, n));
    int64_t smooth = (fits->n - 1) / 4;
    double usual = fits->n > 0 ? select_rank(texture, fits->n, smooth) : 0.0;
    for (int64_t n = 0; n < fits->n; n++) {
        const double *p = fits->parameters + N_PARAMETERS * n;
        const double *information = fits->information + N_PARAMETERS * N_PARAMETERS * n;
        double *row = assessed + N_COLUMNS * n, scale = fits->scale[n];
        double x = (double)fits->origin[2 * n] + p[PAR_X];
        double y = (double)fits->origin[2 * n + 1] + p[PAR_Y];
        double mean = (p[PAR_XX] + p[PAR_YY]) / 2.0, half = (p[PAR_XX] - p[PAR_YY]) / 2.0;
        double split = hypot(half, p[PAR_XY]);
        bool positive = mean > split;
        double longer = positive ? scale / sqrt(mean - split) : scale;
        double shorter = positive ? scale / sqrt(mean + split) : scale;
        double turn = split > 0.0 ? -2.0 * (longer - shorter) / split : 0.0;
        row[COL_CENTRE_X] = x;
        row[COL_CENTRE_Y] = y;
        row[COL_PEAK] = p[PAR_PEAK];
        row[COL_DIAMETER] = longer + shorter;
        row[COL_ELONGATION] = longer / shorter;
        row[COL_STRETCH_X] = turn * half;
        row[COL_STRETCH_Y] = turn * p[PAR_XY];
        centre_covariance(information, fits->root + N_PARAMETERS * N_PARAMETERS * n, row);
        /* where it is rougher than about the smoothest quarter, that is a shape that no LED has */
        assess_shape(fits, n, lifted, MIN(texture[n], usual), row);
        double rim = MIN_BORDER * longer - 0.5;
        double certain = information[(N_PARAMETERS + 1) * PAR_PEAK];
        bool sound = positive && x > rim && y > rim && x < (double)width - 1.0 - rim &&
                     y < (double)height - 1.0 - rim && p[PAR_PEAK] * sqrt(certain) > MIN_PEAK &&
                     longer < MAX_AXIS_RATIO * shorter &&
                     hypot(p[PAR_X], p[PAR_Y]) < MAX_SHIFT * scale + 1.0 &&
                     all_finite(N_PARAMETERS, p);
        row[COL_SOUND] = sound ? 1.0 : 0.0;
    }
    scratch_release(mark);
}

/* Median of n spots' values, so far apart, of those that are not merged, nor at the sensor's limit
 * unless wanted; NaN of none. */
static double median_clear(int64_t n, const double *assessed, bool saturated, const double *values,
                           int64_t apart)
{
    Mark mark = scratch_mark();
    double *some = TAKE(double, n);
    int64_t count = 0;
    for (int64_t k = 0; k < n; k++) {
        const double *row = assessed + N_COLUMNS * k;
        if (row[COL_MERGED] == 0.0 && (saturated || row[COL_SATURATED] == 0.0))
            some[count++] = values[apart * k];
    }
    double found = count > 0 ? median(some, count) : NAN;
    scratch_release(mark);
    return found;
}

void widen_lossy(int64_t n, double *assessed)
{
    double usual = median_clear(n, assessed, false, assessed + COL_MISFIT, N_COLUMNS);
    usual = isnan(usual) ? 1.0 : MAX(usual, MIN_LOSSY_MISFIT);
    for (int64_t k = 0; k < n; k++) {
        double *row = assessed + N_COLUMNS * k;
        double beyond = row[COL_MISFIT] / usual - MAX_LOSSY_MISFIT;
        double odd = MAX(beyond, 0.0) * (1.0 - row[COL_SATURATED]);
        double clipped = row[COL_SATURATED] * row[COL_MISFIT] / MAX_CLIPPED_MISFIT;
        double scale = LOSSY_SHARE * MAX(usual, clipped) * (1.0 + CORRELATED_PIXELS * odd);
        for (int c = COL_COVARIANCE_XX; c <= COL_COVARIANCE_YY; c++)
            row[c] *= row[COL_MERGED] > 0.0 ? 1.0 : scale;
        row[COL_NOISE] *= scale;
    }
}

/* Least stretch of a spot, px, that is doubted: beyond noise and texture, where nothing else would
 * show. */
static double least_stretch(const double *row, double asymmetry)
{
    if (asymmetry < INFINITY)
        return MAX_STRETCH * row[COL_DIAMETER];
    return MIN_STRETCH_SIGMA * sqrt(row[COL_NOISE]);
}

void doubt_shapes(int64_t n, double *assessed, const double *asymmetry)
{
    Mark mark = scratch_mark();
    double *length = TAKE(double, n), x = 0.0, y = 0.0;
    double usual = INFINITY; /* none is longer, where nothing shows what is usual */
    int64_t alike = 0;
    for (int64_t k = 0; k < n; k++) {
        const double *row = assessed + N_COLUMNS * k;
        length[k] = 2.0 * row[COL_DIAMETER] / (1.0 + 1.0 / row[COL_ELONGATION]);
        alike += row[COL_MERGED] == 0.0;
    }
    if (alike >= MIN_ALIKE) {
        x = median_clear(n, assessed, true, assessed + COL_STRETCH_X, N_COLUMNS);
        y = median_clear(n, assessed, true, assessed + COL_STRETCH_Y, N_COLUMNS);
        usual = median_clear(n, assessed, true, length, 1);
    }
    double misfit = median_clear(n, assessed, true, assessed + COL_MISFIT, N_COLUMNS);
    misfit = MAX(1.0, misfit); /* 1 of none */
    for (int64_t k = 0; k < n; k++) {
        double *row = assessed + N_COLUMNS * k;
        double off = hypot(row[COL_STRETCH_X], row[COL_STRETCH_Y]);
        double here = hypot(row[COL_STRETCH_X] - x, row[COL_STRETCH_Y] - y);
        double stretch = MIN(off, here), longer = length[k] / usual;
        double chance = 1.0 + MAX_LONGER_SIGMA * sqrt(2.0 / MAX(row[COL_COUNT], 1.0));
        bool odd = asymmetry[k] > MAX_ASYMMETRY * misfit || longer > MAX_LENGTH ||
                   (row[COL_MISFIT] / misfit > chance && longer > MAX_SURE_LENGTH);
        if (odd && stretch > least_stretch(row, asymmetry[k]))
            row[COL_MERGED] = 1.0;
        if (row[COL_MERGED] > 0.0) {
            double doubt = STRETCH_SHARE * stretch * row[COL_DIAMETER];
            row[COL_COVARIANCE_XX] += doubt;
            row[COL_COVARIANCE_YY] += doubt;
        }
    }
    scratch_release(mark);
}

static double centres_apart(const double *row, const double *other)
{
    return hypot(row[COL_CENTRE_X] - other[COL_CENTRE_X], row[COL_CENTRE_Y] - other[COL_CENTRE_Y]);
}

/* Whether a spot lies on the disc of another, larger one, whose shape is that of one LED.
 *
 * A few pixels of a disc's rim fit a small spot, with so little freedom that nothing misfits. */
static bool is_part(const double *row, const double *other)
{
    return row[COL_DIAMETER] < MAX_PART * other[COL_DIAMETER] &&
           row[COL_PEAK] < MAX_PART_PEAK * other[COL_PEAK] && /* no LED before a glow */
           other[COL_MERGED] == 0.0 && centres_apart(row, other) < other[COL_DIAMETER] / 2.0;
}

/* Whether a spot is another one of m spots: a part of its disc, or fitting better or first. */
static bool is_found_again(const double *assessed, int64_t m, const int64_t *spots, int64_t n)
{
    const double *row = assessed + N_COLUMNS * n;
    for (int64_t at = 0; at < m; at++) {
        int64_t k = spots[at];
        const double *other = assessed + N_COLUMNS * k;
        if (k == n || is_part(other, row))
            continue;
        bool better = other[COL_MISFIT] < row[COL_MISFIT] ||
                      (k < n && other[COL_MISFIT] == row[COL_MISFIT]);
        double near = MIN_SEPARATION * MIN(row[COL_DIAMETER], other[COL_DIAMETER]);
        if (is_part(row, other) || (better && centres_apart(row, other) < near))
            return true;
    }
    return false;
}

int64_t choose_spots(int64_t n, const double *assessed, double least, double largest, int64_t limit,
                     int64_t *kept)
{
    Mark mark = scratch_mark();
    int64_t *sound = TAKE(int64_t, n), count = 0, single = 0;
    double *rank = TAKE(double, n), *height = TAKE(double, n);
    for (int64_t k = 0; k < n; k++) {
        const double *row = assessed + N_COLUMNS * k;
        if (row[COL_SOUND] > 0.0 && least <= row[COL_DIAMETER] && row[COL_DIAMETER] <= largest)
            sound[count++] = k;
        height[k] = -row[COL_PEAK];
        rank[k] = -row[COL_PEAK] / (1.0 + row[COL_SHAPE]) / row[COL_ELONGATION];
    }
    for (int64_t at = 0; at < count; at++)
        if (!is_found_again(assessed, count, sound, sound[at]))
            kept[single++] = sound[at];
    count = first_by(rank, single, kept, limit);
    first_by(height, count, kept, count);
    scratch_release(mark);
    return count;
}

int64_t entry_choose_spots(int64_t n, const double *assessed, double least, double largest,
                           int64_t limit, int64_t *kept)
{
    GUARDED(choose_spots(n, assessed, least, largest, limit, kept));
}
