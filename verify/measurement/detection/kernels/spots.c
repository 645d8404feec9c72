/* Measure the spots of a picture in one go: fit its candidates, assess, correct and choose them.
 *
 * Spots whose light reaches each other's pixels are fitted anew, each without that of the others.
 */
#include <math.h>

#include "verify/core/kernels/linear_algebra.h"
#include "verify/core/kernels/scratch.h"
#include "verify/measurement/detection/kernels/background.h"
#include "verify/measurement/detection/kernels/candidates.h"
#include "verify/measurement/detection/kernels/fit.h"
#include "verify/measurement/detection/kernels/noise.h"
#include "verify/measurement/detection/kernels/occlusion.h"
#include "verify/measurement/detection/kernels/quality.h"
#include "verify/measurement/detection/kernels/residual_noise.h"

#define MAX_AT_ONCE 5000.0 /* pixels of a picture's candidates that are fitted without a first look */
#define MAX_CLEAN_ELONGATION 1.2 /* of spots whose light is taken off others: glints are longer */
#define SEPARATION_PASSES 4 /* of spots touching at a third of their height; two suffice farther apart */
#define MIN_NEIGHBOUR 0.15 /* of a spot's peak, of another one's: less may be texture of the room */
#define MIN_LIGHT 0.5 /* DN of a neighbour: less is not worth taking off, least of all below black */
#define LOSSY_NOISE 0.5 /* of an even room's noise, as far as it moves centres, a JPEG leaves */
#define WIDTH_STEP 1.0 /* px, to which a candidate's width is known */
#define TINY 1e-9     /* of an inverse square of a half-width, where a fit has none */

/* What is wanted of a picture. */
typedef struct {
    double least, largest; /* diameter, px */
    int64_t limit;         /* how many at most */
    bool whole; /* all of it was searched: of many or large ones only those of a first look are fitted */
    bool lossy; /* it was a JPEG */
} Wanted;

/* Room for `limit` spots, as the fields of `Spots`. */
typedef struct {
    double *centre, *covariance, *figures, *colours; /* figures (3, limit): peak, diameter, misfit */
    bool *flags;                                     /* (2, limit): saturated, merged */
} SpotArrays;

/* Fit the n candidates (n, 4), on a glance only those in which a first look sees a spot. */
static Fits fit_candidates(const Picture *picture, int64_t n, const double *candidates,
                           const double *noise, Table table, bool glance)
{
    double read = sqrt(noise[0]), *start = TAKE(double, N_PARAMETERS * n);
    if (glance) {
        double *sound = TAKE(double, 4 * n), *assessed = TAKE(double, N_COLUMNS * n);
        Mark mark = scratch_mark();
        Fits first = cut_patches(picture, n, candidates, true);
        for (int64_t k = 0; k < n; k++) {
            expect_spot(&first, k, read);
            fit_spot(&first, k, noise, table, MAX_STEPS_FIRST_LOOK, TOL_FIRST_LOOK);
        }
        assess_all(&first, picture->width, picture->height, CORRELATED_PIXELS, assessed);
        int64_t count = 0;
        for (int64_t k = 0; k < n; k++) {
            if (!(assessed[N_COLUMNS * k + COL_SOUND] > 0.0))
                continue;
            copy(sound + 4 * count, candidates + 4 * k, 4);
            copy(start + N_PARAMETERS * count, first.parameters + N_PARAMETERS * k, N_PARAMETERS);
            count++;
        }
        scratch_release(mark);
        candidates = sound;
        n = count;
    }
    Fits fits = cut_patches(picture, n, candidates, false);
    for (int64_t k = 0; k < n; k++) {
        expect_spot(&fits, k, read);
        if (glance)
            copy(fits.parameters + N_PARAMETERS * k, start + N_PARAMETERS * k, N_PARAMETERS);
        fit_from_start(&fits, k, noise, table);
    }
    return fits;
}

/* Fill in which clean spots' light reaches which others' pixels, (n, n); whether any does. */
static bool find_neighbours(const Fits *fits, const double *assessed, bool *near)
{
    Mark mark = scratch_mark();
    bool *clean = TAKE(bool, fits->n), found = false;
    double *radius = TAKE(double, fits->n);
    for (int64_t n = 0; n < fits->n; n++) {
        const double *p = fits->parameters + N_PARAMETERS * n, *row = assessed + N_COLUMNS * n;
        radius[n] = fits->scale[n] * sqrt(2.0 / MAX(p[PAR_XX] + p[PAR_YY], TINY));
        clean[n] = row[COL_SOUND] > 0.0 && row[COL_MERGED] == 0.0;
        clean[n] = clean[n] && row[COL_ELONGATION] < MAX_CLEAN_ELONGATION;
    }
    for (int64_t n = 0; n < fits->n; n++) {
        for (int64_t k = 0; k < fits->n; k++) {
            const double *p = fits->parameters + N_PARAMETERS * n;
            const double *its = fits->parameters + N_PARAMETERS * k;
            double x = (double)(fits->origin[2 * n] - fits->origin[2 * k]) + p[PAR_X] - its[PAR_X];
            double y = (double)(fits->origin[2 * n + 1] - fits->origin[2 * k + 1]);
            double apart = hypot(x, y + p[PAR_Y] - its[PAR_Y]) / (radius[n] + radius[k]);
            near[n * fits->n + k] = clean[n] && clean[k] && MIN_APART < apart && apart < MAX_APART
                                    && its[PAR_PEAK] > MIN_NEIGHBOUR * p[PAR_PEAK];
            found = found || near[n * fits->n + k];
        }
    }
    scratch_release(mark);
    return found;
}

/* Take another spot's light, of that shape (10,), off a spot's pixels; whether it has any. */
static bool take_light(const Fits *fits, int64_t n, int64_t other, const double *shape, Table table)
{
    int64_t p = pixels_of(fits, n), last = table.n_samples - 1;
    float *rows = rows_of(fits, n), *value = rows + ROW_VALUE * pitch(p);
    const float *column = rows + ROW_COLUMN * pitch(p), *row = rows + ROW_ROW * pitch(p);
    double scale = fits->scale[other];
    double x = (double)(fits->origin[2 * other] - fits->origin[2 * n]) + shape[PAR_X];
    double y = (double)(fits->origin[2 * other + 1] - fits->origin[2 * n + 1]) + shape[PAR_Y];
    double place = profile_line(shape[PAR_STEEPNESS], table);
    int64_t line = (int64_t)place;
    const float *samples = table.values + 4 * table.n_samples * line;
    bool taken = false;
    for (int64_t k = 0; k < p; k++) {
        double u = (column[k] - x) / scale, w = (row[k] - y) / scale;
        double t2 = shape[PAR_XX] * u * u + 2.0 * shape[PAR_XY] * u * w + shape[PAR_YY] * w * w;
        double at = MIN(sqrt(MAX(t2, 0.0)) / PROFILE_RADIUS_STEP, (double)last - 1e-9), light = 0.0;
        int64_t low = (int64_t)at;
        for (int sample = 0; sample < 2; sample++) {
            const float *one = samples + 4 * (low + sample);
            double height = one[0] + (place - (double)line) * one[1], off = at - (double)low;
            light += shape[PAR_PEAK] * height * (sample == 1 ? off : 1.0 - off);
        }
        if (light > MIN_LIGHT) {
            value[k] = (float)(value[k] - light);
            taken = true;
        }
    }
    return taken;
}

/* Fit clean spots near each other anew, each without the light that the others have there; says
 * whether there are any. Spots nearer than MIN_APART are not told apart. */
static bool separate_neighbours(Fits *fits, const double *assessed, const double *noise, Table table)
{
    Mark mark = scratch_mark();
    int64_t count = fits->n;
    bool *near = TAKE(bool, count * count), found = find_neighbours(fits, assessed, near);
    float *read = TAKE(float, fits->begin[count]);
    double *shape = TAKE(double, N_PARAMETERS * count);
    for (int64_t n = 0; found && n < count; n++)
        memcpy(read + fits->begin[n], rows_of(fits, n) + ROW_VALUE * pitch(pixels_of(fits, n)),
               sizeof(float) * (size_t)pixels_of(fits, n));
    for (int pass = 0; pass < (found ? SEPARATION_PASSES : 0); pass++) {
        copy(shape, fits->parameters, N_PARAMETERS * count);
        for (int64_t n = 0; n < count; n++) {
            int64_t p = pixels_of(fits, n);
            bool taken = false;
            memcpy(rows_of(fits, n) + ROW_VALUE * pitch(p), read + fits->begin[n],
                   sizeof(float) * (size_t)p);
            for (int64_t k = 0; k < count; k++)
                if (near[n * count + k])
                    taken = take_light(fits, n, k, shape + N_PARAMETERS * k, table) || taken;
            if (taken)
                fit_spot(fits, n, noise, table, LAST_STEPS, TOL_LAST_STEP);
        }
        if (!find_neighbours(fits, assessed, near))
            break;
    }
    scratch_release(mark);
    return found;
}

/* Copy spots' rows (count, 16) to their arrays. */
static void copy_spots(int64_t count, const double *rows, int64_t limit, const SpotArrays *arrays)
{
    static const int FIGURES[] = {COL_PEAK, COL_DIAMETER, COL_MISFIT};
    static const int FLAGS[] = {COL_SATURATED, COL_MERGED};
    for (int64_t m = 0; m < count; m++) {
        const double *row = rows + N_COLUMNS * m;
        copy(arrays->centre + 2 * m, row + COL_CENTRE_X, 2);
        copy(arrays->covariance + 4 * m, row + COL_COVARIANCE_XX, 4);
        for (int i = 0; i < 3; i++)
            arrays->figures[i * limit + m] = row[FIGURES[i]];
        for (int i = 0; i < 2; i++)
            arrays->flags[i * limit + m] = row[FLAGS[i]] > 0.0;
    }
}

/* Choose, correct and copy the spots. Gives how many. */
static int64_t finish_spots(const Picture *picture, int64_t n, const double *candidates,
                            const Fits *fits, const double *assessed, const Wanted *wanted,
                            const SpotArrays *arrays)
{
    int64_t *kept = TAKE(int64_t, fits->n);
    int64_t count = choose_spots(fits->n, assessed, wanted->least, wanted->largest, wanted->limit,
                                 kept);
    double *rows = TAKE(double, N_COLUMNS * count);
    double *moments = TAKE(double, 6 * count), *asymmetry = TAKE(double, count);
    double *score = TAKE(double, 4 * N_DIRECTIONS * count);
    for (int64_t m = 0; m < count; m++) {
        copy(rows + N_COLUMNS * m, assessed + N_COLUMNS * kept[m], N_COLUMNS);
        copy(arrays->colours + 3 * m, fits->colour + 3 * kept[m], 3);
    }
    for (int64_t k = 0; k < 6 * count; k++)
        moments[k] = 0.0;
    if (wanted->lossy)
        widen_lossy(count, rows);
    score_spots(fits, count, kept, rows, score, asymmetry);
    doubt_shapes(count, rows, asymmetry);
    correct_for_bites(count, score, rows, moments);
    Surroundings around = {picture, n, candidates, wanted->lossy ? LOSSY_NOISE : 1.0};
    correct_for_room(&around, fits, count, kept, rows, moments);
    for (int64_t m = 0; m < count; m++) {
        double *row = rows + N_COLUMNS * m;
        for (int i = 0; i < 2; i++) {
            const double *moment = moments + 6 * m + 3 * i;
            row[COL_CENTRE_X + i] += moment[0];
            row[COL_COVARIANCE_XX + 2 * i] += moment[1];
            row[COL_COVARIANCE_XY + 2 * i] += moment[2];
        }
    }
    copy_spots(count, rows, wanted->limit, arrays);
    return count;
}

/* Measure the spots of a picture, and count them; see `measure_spots` in entries.py. */
static int64_t measure_spots(const Picture *picture, int64_t n, const double *candidates,
                             double *noise, Table table, const Wanted *wanted, bool unknown,
                             const SpotArrays *arrays)
{
    int64_t width = picture->width, height = picture->height;
    double pixels = 0.0, lifted = wanted->lossy ? 0.0 : CORRELATED_PIXELS;
    if (unknown)
        background_noise(picture, wanted->lossy, noise);
    for (int64_t k = 0; k < n; k++)
        pixels += acos(-1.0) * square(PATCH_REACH * candidates[4 * k + 2] + PATCH_MARGIN);
    bool glance = wanted->whole && pixels > MAX_AT_ONCE;
    Fits fits = fit_candidates(picture, n, candidates, noise, table, glance);
    if (fits.n == 0)
        return 0;
    double *assessed = TAKE(double, N_COLUMNS * fits.n);
    if (unknown) {
        assess_all(&fits, width, height, CORRELATED_PIXELS, assessed);
        refine_noise(&fits, assessed, noise, noise[3]);
    }
    for (int64_t k = 0; k < fits.n; k++)
        if (unknown || !fits.settled[k])
            fit_spot(&fits, k, noise, table, LAST_STEPS, TOL_LAST_STEP);
    assess_all(&fits, width, height, lifted, assessed);
    if (separate_neighbours(&fits, assessed, noise, table))
        assess_all(&fits, width, height, lifted, assessed);
    return finish_spots(picture, n, candidates, &fits, assessed, wanted, arrays);
}

/* Measure the spots in small windows (n, 4) of a grey picture: at most so many candidates. */
static int64_t measure_in_windows(const Picture *picture, int64_t n, const double *windows,
                                  const BlobSearch *search, int64_t most, double *noise,
                                  Table table, const Wanted *wanted, bool unknown,
                                  const SpotArrays *arrays)
{
    double *candidates = TAKE(double, 4 * most);
    Grid grey = {picture->values, picture->height, picture->width};
    int64_t found = search_windows(grey, n, windows, search, wanted->least - WIDTH_STEP,
                                   wanted->largest + WIDTH_STEP, most, candidates);
    return measure_spots(picture, found, candidates, noise, table, wanted, unknown, arrays);
}

int64_t entry_measure_spots(const uint8_t *values, int64_t width, int64_t height, int64_t channels,
                            int64_t n, const double *candidates, double *noise, int64_t n_rows,
                            int64_t n_samples, const float *table, double least, double largest,
                            int64_t limit, int64_t whole, int64_t lossy, int64_t unknown,
                            double *centre, double *covariance, double *figures, bool *flags,
                            double *colours)
{
    Picture picture = {values, width, height, channels};
    Wanted wanted = {least, largest, limit, whole != 0, lossy != 0};
    SpotArrays arrays = {centre, covariance, figures, colours, flags};
    GUARDED(measure_spots(&picture, n, candidates, noise, (Table){table, n_rows, n_samples}, &wanted,
                          unknown != 0, &arrays));
}

int64_t entry_measure_in_windows(const uint8_t *values, int64_t width, int64_t height, int64_t n,
                                 const double *windows, int64_t reach, int64_t n_levels,
                                 const int64_t *levels, double side, double half_side,
                                 double axis_ratio, double fill, int64_t listed, int64_t most,
                                 double *noise, int64_t n_rows, int64_t n_samples,
                                 const float *table, double least, double largest, int64_t limit,
                                 int64_t lossy, int64_t unknown, double *centre,
                                 double *covariance, double *figures, bool *flags, double *colours)
{
    Picture picture = {values, width, height, 1};
    BlobSearch search = {reach, n_levels, levels, {side, half_side, axis_ratio, fill}, listed};
    Wanted wanted = {least, largest, limit, false, lossy != 0};
    SpotArrays arrays = {centre, covariance, figures, colours, flags};
    GUARDED(measure_in_windows(&picture, n, windows, &search, most, noise,
                               (Table){table, n_rows, n_samples}, &wanted, unknown != 0, &arrays));
}
