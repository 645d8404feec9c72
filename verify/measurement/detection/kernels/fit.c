#include "verify/measurement/detection/kernels/fit.h"

#include <math.h>

#include "verify/core/kernels/linear_algebra.h"
#include "verify/core/kernels/scratch.h"

#define FIRST_DAMPING 1e-4
#define CORE_RADIUS2 2.25f /* half-widths^2: the spot's own pixels, by which its fit is judged */
#define MIN_CORE_RADIUS2 9.0f /* px^2, of the smallest: 28 pixels against 8 parameters */
#define MAX_STEPS 8           /* from a first look on; a clean spot takes two */
#define MAX_STEPS_SATURATED 20 /* its top is hidden, the valley long */
#define TOL_SATURATED 0.001 /* of chi^2: a step may gain little and the next more */
#define START_STEEPNESS_SATURATED log(5.0) /* an in-focus LED, whose flat top is real */
#define START_STEEPNESS log(2.2)           /* between a Gaussian (1.39) and an in-focus LED (5) */
/* Priors, standard deviations. All but the slopes' concern terms that are even about the centre and
 * leave it alone; they only keep a dim or a fully saturated spot from drifting off. */
#define PRIOR_STEEPNESS 1.0
#define PRIOR_PEAK 2000.0 /* DN: eight times the sensor's range */
#define PRIOR_FLOOR 10.0  /* DN: a floor below black does not show */
#define PRIOR_SHAPE 2.0   /* of (half-width / start)^-2 */
#define NEAR_LIMIT 3.0 /* DN below the limit: a top so near it is cut off, and higher than it seems */
#define PEAK_FACTOR_CLIPPED 1.3 /* peak over the core's mean: cut off, and whole */
#define PEAK_FACTOR 1.05
#define MAX_SLOPE 30.0f /* DN about the floor: a neighbour is no slope */
#define MIN_LOG_STEEPNESS 0.3 /* logarithms: no guess of a steepness is beyond */
#define MAX_LOG_STEEPNESS 2.5
#define BLUR_BIAS 0.1 /* logarithm, by which counted pixels look steeper than the spot */
#define HALO_DN 0.7   /* DN, of a spot's light in the pixels that its floor is guessed from */
#define MAX_BLACK_SHARE 0.98 /* of pixels: with more, a floor below black cannot be guessed */
#define LOGISTIC_SCALE 1.702 /* on which a logistic law is a normal one, to 0.01 (Camilli, 1994) */

#define N_SQUARE (N_PARAMETERS * N_PARAMETERS)

/* Scalar products of two rows (2, p) with four others (4, p), to (2, n) of `product`, in either
 * precision. */
static void products_precise(int64_t n, int64_t p, const float *restrict rows,
                             const float *restrict others, double *product)
{
    for (int one = 0; one < 2; one++, rows += pitch(p), product += n) {
        double first = 0.0, second = 0.0, third = 0.0, fourth = 0.0;
#pragma omp simd reduction(+ : first, second, third, fourth)
        for (int64_t k = 0; k < p; k++) {
            double own = rows[k];
            first += own * (double)others[k];
            second += own * (double)others[pitch(p) + k];
            third += own * (double)others[2 * pitch(p) + k];
            fourth += own * (double)others[3 * pitch(p) + k];
        }
        product[0] = first, product[1] = second, product[2] = third, product[3] = fourth;
    }
}

static void products_single(int64_t n, int64_t p, const float *restrict rows,
                            const float *restrict others, double *product)
{
    float first = 0.0f, second = 0.0f, third = 0.0f, fourth = 0.0f;
    float next_first = 0.0f, next_second = 0.0f, next_third = 0.0f, next_fourth = 0.0f;
#pragma omp simd reduction(+ : first, second, third, fourth, next_first, next_second, next_third, \
                               next_fourth)
    for (int64_t k = 0; k < p; k++) {
        float own = rows[k], next = rows[pitch(p) + k];
        first += own * others[k];
        second += own * others[pitch(p) + k];
        third += own * others[2 * pitch(p) + k];
        fourth += own * others[3 * pitch(p) + k];
        next_first += next * others[k];
        next_second += next * others[pitch(p) + k];
        next_third += next * others[2 * pitch(p) + k];
        next_fourth += next * others[3 * pitch(p) + k];
    }
    product[0] = first, product[1] = second, product[2] = third, product[3] = fourth;
    product += n;
    product[0] = next_first, product[1] = next_second;
    product[2] = next_third, product[3] = next_fourth;
}

void multiply_rows(int64_t m, int64_t n, int64_t p, const float *rows, const float *others,
                   bool precise, double *products)
{
    for (int64_t a = 0; a < m; a += 2)
        for (int64_t b = rows == others ? a / 4 * 4 : 0; b < n; b += 4)
            (precise ? products_precise : products_single)(n, pitch(p), rows + a * pitch(p),
                                                           others + b * pitch(p),
                                                           products + a * n + b);
    for (int64_t a = 4; rows == others && a < m; a++)
        for (int64_t b = 0; b < a / 4 * 4; b++)
            products[a * n + b] = products[b * n + a];
}

/* Sum the pixels up; `prior` (2, 10). Gives chi^2.
 *
 * `left_out`: what the pixels left out add to it; `saturated`: its parameters are so alike then that
 * single precision does not tell them apart. Filled: information (10, 10) and gradient (10,). */
static double normal_equations(const double *parameters, int64_t p, const float *rows,
                               double left_out, bool saturated, const double *prior,
                               double *information, double *gradient)
{
    enum { N = N_WHITENED + 1 }; /* a multiple of four; the row behind, of values, means nothing */
    double products[N * N];
    multiply_rows(N, N, p, rows, rows, saturated, products);
    double chi2 = products[ROW_RESIDUAL * N + ROW_RESIDUAL] + left_out;
    for (int a = 0; a < N_PARAMETERS; a++) {
        double off = prior[a] - parameters[a], weight = prior[N_PARAMETERS + a];
        for (int b = 0; b < N_PARAMETERS; b++)
            information[a * N_PARAMETERS + b] = products[a * N + b];
        information[a * N_PARAMETERS + a] += weight;
        gradient[a] = products[ROW_RESIDUAL * N + a] + weight * off;
        chi2 += weight * off * off;
    }
    return chi2;
}

/* Shorten a step (10,) where the linearisation no longer means anything; tells whether it did. */
static bool limit_step(const double *p, double *step)
{
    double least = MIN(p[PAR_XX], p[PAR_YY]);
    double ratio = MAX(fabs(step[PAR_X]), fabs(step[PAR_Y])) / 1.5; /* px */
    double lean = MAX(fabs(step[PAR_SLOPE_X]), fabs(step[PAR_SLOPE_Y])) / 5.0; /* DN a px */
    double shape = MAX(fabs(step[PAR_XX]), fabs(step[PAR_XY]));
    shape = MAX(shape, fabs(step[PAR_YY])) / (0.45 * least);
    ratio = MAX(ratio, fabs(step[PAR_PEAK]) / (0.7 * p[PAR_PEAK]));
    ratio = MAX(ratio, fabs(step[PAR_FLOOR]) / 30.0); /* DN */
    ratio = MAX(ratio, lean);
    ratio = MAX(ratio, shape);
    ratio = MAX(ratio, fabs(step[PAR_STEEPNESS]) / 0.5);
    if (!(ratio > 1.0))
        return false;
    for (int a = 0; a < N_PARAMETERS; a++)
        step[a] /= ratio;
    return true;
}

/* Find the next step (10,): what it takes from chi^2, and whether it was shortened. */
static double find_step(const double *p, const double *information, const double *gradient,
                        double damping, double *step, bool *shortened)
{
    double damped[N_SQUARE], root[N_SQUARE], gained = 0.0;
    copy(damped, information, N_SQUARE);
    for (int a = 0; a < N_PARAMETERS; a++) {
        double *diagonal = damped + a * (N_PARAMETERS + 1);
        *diagonal = *diagonal * (1.0 + damping) + MIN_INFORMATION;
    }
    factor(N_PARAMETERS, damped, 0.0, root);
    copy(step, gradient, N_PARAMETERS);
    solve(N_PARAMETERS, root, step);
    *shortened = limit_step(p, step);
    for (int a = 0; a < N_PARAMETERS; a++)
        gained += step[a] * gradient[a];
    return gained;
}

/* Let the means of the pixels that count follow a small step (10,), to first order. */
static void update_means(const double *step, int64_t p, float *rows)
{
    float of[N_PARAMETERS];
    for (int a = 0; a < N_PARAMETERS; a++)
        of[a] = (float)step[a];
    const float *restrict by = rows, *restrict variance = rows + ROW_VARIANCE * pitch(p);
    float *restrict mean = rows + ROW_MEAN * pitch(p);
#pragma omp simd
    for (int64_t k = 0; k < pitch(p); k++) {
        float moved = 0.0f;
        for (int a = 0; a < N_PARAMETERS; a++)
            moved += of[a] * by[a * pitch(p) + k];
        mean[k] += moved * sqrtf(variance[k]);
    }
}

/* Mark the pixels that are the spot's own: its core, and for the smallest a few about it. */
static void mark_core(const double *parameters, int64_t p, float *rows)
{
    const float *restrict column = rows + ROW_COLUMN * pitch(p);
    const float *restrict row = rows + ROW_ROW * pitch(p);
    const float *restrict radius2 = rows + ROW_RADIUS2 * pitch(p);
    const float *restrict valid = rows + ROW_VALID * pitch(p);
    float *restrict core = rows + ROW_CORE * pitch(p);
    float x = (float)parameters[PAR_X], y = (float)parameters[PAR_Y];
#pragma omp simd
    for (int64_t k = 0; k < pitch(p); k++) {
        float u = column[k] - x, w = row[k] - y;
        bool near = (radius2[k] < CORE_RADIUS2) | (u * u + w * w < MIN_CORE_RADIUS2);
        core[k] = near ? valid[k] : 0.0f;
    }
}

/* Chi^2 of a patch at parameters (10,) under given variances (p,): `rows` give the means alone. */
static double chi_squared(const double *parameters, int64_t p, const float *rows,
                          const float *restrict variance, const double *prior)
{
    const float *restrict value = rows + ROW_VALUE * pitch(p);
    const float *restrict mean = rows + ROW_MEAN * pitch(p);
    const float *restrict radius2 = rows + ROW_RADIUS2 * pitch(p);
    const float *restrict valid = rows + ROW_VALID * pitch(p);
    float total = 0.0f, most = OUTLIER_SIGMA * OUTLIER_SIGMA;
#pragma omp simd reduction(+ : total)
    for (int64_t k = 0; k < pitch(p); k++) {
        float residual = value[k] - mean[k], square = residual * residual / variance[k];
        bool outside = radius2[k] > NEIGHBOUR_RADIUS * NEIGHBOUR_RADIUS;
        total += valid[k] * (outside & (square > most) ? most : square);
    }
    double chi2 = total;
    for (int a = 0; a < N_PARAMETERS; a++)
        chi2 += prior[N_PARAMETERS + a] * square(prior[a] - parameters[a]);
    return chi2;
}

void fit_spot(Fits *fits, int64_t n, const double *noise, Table table, int steps, double tolerance)
{
    Mark mark = scratch_mark();
    int64_t p = pixels_of(fits, n);
    double *best = fits->parameters + N_PARAMETERS * n, *prior = fits->prior + 2 * N_PARAMETERS * n;
    double *information = fits->information + N_SQUARE * n, scale = fits->scale[n];
    double *gradient = fits->gradient + N_PARAMETERS * n, step[N_PARAMETERS], tried[N_PARAMETERS];
    double tried_information[N_SQUARE], tried_gradient[N_PARAMETERS];
    double own[3] = {fits->share[2 * n] * noise[0], fits->share[2 * n + 1] * noise[1], noise[2]};
    float *rows = rows_of(fits, n), *variance = TAKE(float, pitch(p));
    bool full = fits->saturated[n], refused = false, shortened;
    size_t variances = sizeof(float) * (size_t)pitch(p);
    double out = weigh_pixels(best, scale, own, table, p, rows), damping = FIRST_DAMPING;
    double chi2 = normal_equations(best, p, rows, out, full, prior, information, gradient);
    double accepted = chi2;
    memcpy(variance, rows + ROW_VARIANCE * pitch(p), variances);
    fits->settled[n] = false;
    for (int taken = 0; taken < steps; taken++) {
        double gained = find_step(best, information, gradient, damping, step, &shortened);
        if (gained <= tolerance * (1.0 + chi2 / (double)p) && !shortened) {
            for (int a = 0; a < N_PARAMETERS; a++)
                best[a] += step[a];
            chi2 -= gained;
            update_means(step, p, rows);
            fits->settled[n] = true;
            break;
        }
        for (int a = 0; a < N_PARAMETERS; a++)
            tried[a] = best[a] + step[a];
        out = weigh_pixels(tried, scale, own, table, p, rows);
        double trial = normal_equations(tried, p, rows, out, full, prior, tried_information,
                                        tried_gradient);
        /* The weights move with the model, and chi^2 with them: a step is judged by those that it was
         * found with. */
        refused = !(chi_squared(tried, p, rows, variance, prior) <= 1.1 * accepted + 1.0);
        if (refused) {
            damping *= 30.0;
            continue;
        }
        copy(best, tried, N_PARAMETERS);
        copy(information, tried_information, N_SQUARE);
        copy(gradient, tried_gradient, N_PARAMETERS);
        memcpy(variance, rows + ROW_VARIANCE * pitch(p), variances);
        chi2 = accepted = trial;
        damping /= 10.0;
    }
    if (refused)
        weigh_pixels(best, scale, own, table, p, rows);
    mark_core(best, p, rows);
    fits->chi2[n] = chi2;
    scratch_release(mark);
}

/* A clear spot comes within a step of its optimum. A saturated spot is fitted from two starts, as its
 * hidden top may be steep or flat. */
void fit_from_start(Fits *fits, int64_t n, const double *noise, Table table)
{
    fit_spot(fits, n, noise, table, MAX_STEPS, TOL_LAST_STEP);
    if (!fits->saturated[n])
        return;
    fit_spot(fits, n, noise, table, MAX_STEPS_SATURATED, TOL_SATURATED);
    Mark mark = scratch_mark();
    double *steep = fits->parameters + N_PARAMETERS * n, flat[N_PARAMETERS];
    double information[N_SQUARE], gradient[N_PARAMETERS], chi2 = fits->chi2[n];
    float *rows = rows_of(fits, n);
    size_t size = sizeof(float) * (size_t)(N_ROWS * pitch(pixels_of(fits, n)));
    float *held = scratch_take(size);
    memcpy(held, rows, size);
    copy(flat, steep, N_PARAMETERS);
    copy(information, fits->information + N_SQUARE * n, N_SQUARE);
    copy(gradient, fits->gradient + N_PARAMETERS * n, N_PARAMETERS);
    copy(steep, fits->prior + 2 * N_PARAMETERS * n, N_PARAMETERS);
    steep[PAR_STEEPNESS] = START_STEEPNESS_SATURATED;
    steep[PAR_PEAK] = (double)SENSOR_LIMIT - steep[PAR_FLOOR];
    fit_spot(fits, n, noise, table, MAX_STEPS_SATURATED, TOL_SATURATED);
    if (chi2 <= fits->chi2[n]) {
        copy(steep, flat, N_PARAMETERS);
        copy(fits->information + N_SQUARE * n, information, N_SQUARE);
        copy(fits->gradient + N_PARAMETERS * n, gradient, N_PARAMETERS);
        memcpy(rows, held, size);
        fits->chi2[n] = chi2;
        fits->settled[n] = false;
    }
    scratch_release(mark);
}

/* Hold the slopes (10,) as firmly as the pixels about the spot have none; give its top, DN. */
static double floor_priors(int64_t p, const float *rows, double scale, double floor, double *weight)
{
    const float *restrict column = rows + ROW_COLUMN * pitch(p);
    const float *restrict row = rows + ROW_ROW * pitch(p);
    const float *restrict value = rows + ROW_VALUE * pitch(p);
    const float *restrict valid = rows + ROW_VALID * pitch(p);
    float core = (float)square(0.5 * scale + 0.5), ring = (float)square(SLOPE_REACH * scale + 1.0);
    float total = 0.0f, count = 0.0f, level = (float)floor;
    float lean_x = 0.0f, lean_y = 0.0f, lever_x = 0.0f, lever_y = 0.0f;
#pragma omp simd reduction(+ : total, count, lean_x, lean_y, lever_x, lever_y)
    for (int64_t k = 0; k < p; k++) {
        float x = column[k], y = row[k], distance2 = x * x + y * y, over = value[k] - level;
        float inner = distance2 <= core ? valid[k] : 0.0f;
        float outer = (distance2 > ring) & (distance2 > core) ? valid[k] : 0.0f;
        float excess = MIN(MAX(over, -MAX_SLOPE), MAX_SLOPE) * outer;
        total += inner * value[k];
        count += inner;
        lean_x += excess * x;
        lean_y += excess * y;
        lever_x += outer * x * x;
        lever_y += outer * y * y;
    }
    /* A slope costs the centre information, so it is let in as far as the surroundings have one along
     * either axis: along one alone they may have none by chance. */
    double slope_x = (double)(lean_x / MAX(lever_x, 1.0f));
    double slope_y = (double)(lean_y / MAX(lever_y, 1.0f));
    weight[PAR_SLOPE_X] = weight[PAR_SLOPE_Y] = 2.0 / (square(slope_x) + square(slope_y) + 1e-8);
    return (double)(total / MAX(count, 1.0f));
}

/* Guess the floor where black cuts it off, from how many of the values (p,) are black. */
static double floor_below_black(int64_t p, const float *value, double read)
{
    int64_t black = 0;
    for (int64_t k = 0; k < p; k++)
        black += value[k] < 0.5f;
    double share = MIN((double)black / (double)p, MAX_BLACK_SHARE);
    return 0.5 - read * log(share / (1.0 - share)) / LOGISTIC_SCALE;
}

/* Guess a spot's place from its pixels over 1/4 of its height, its steepness from how many.
 *
 * `floor` and `top`, DN; `scale`, px, half-width that the fit starts from; `start` (10,), changed
 * where the pixels show it. */
static void start_values(int64_t p, const float *rows, double scale, double floor, double top,
                         double *start)
{
    const float *restrict column = rows + ROW_COLUMN * pitch(p);
    const float *restrict row = rows + ROW_ROW * pitch(p);
    const float *restrict value = rows + ROW_VALUE * pitch(p);
    float height = (float)(top - floor), near = (float)square(2.2 * scale);
    float foot = (float)floor + 0.25f * height, half = 0.5f * height;
    float wide = 0.0f, narrow = 0.0f, light = 0.0f, right = 0.0f, down = 0.0f;
#pragma omp simd reduction(+ : wide, narrow, light, right, down)
    for (int64_t k = 0; k < p; k++) {
        float x = column[k], y = row[k], over = value[k] - foot;
        float one = (over > 0.0f) & (x * x + y * y < near) ? 1.0f : 0.0f;
        wide += one;
        narrow += over > half ? one : 0.0f;
        light += one * over;
        right += one * over * x;
        down += one * over * y;
    }
    if (light > 0.0f) {
        start[PAR_X] = (double)(right / light);
        start[PAR_Y] = (double)(down / light);
    }
    if (4.0f <= narrow && narrow < wide) {
        /* areas go with the square of radii */
        double guess = log(2.0 * log(3.0) / log((double)(wide / narrow))) - BLUR_BIAS;
        start[PAR_STEEPNESS] = MIN(MAX(guess, MIN_LOG_STEEPNESS), MAX_LOG_STEEPNESS);
    }
}

void expect_spot(Fits *fits, int64_t n, double read)
{
    int64_t p = pixels_of(fits, n);
    const float *rows = rows_of(fits, n), *value = rows + ROW_VALUE * pitch(p);
    const float *column = rows + ROW_COLUMN * pitch(p), *row = rows + ROW_ROW * pitch(p);
    double *mean = fits->prior + 2 * N_PARAMETERS * n, *weight = mean + N_PARAMETERS;
    double *start = fits->parameters + N_PARAMETERS * n;
    double scale = fits->scale[n], floor = fits->level[n];
    for (int a = 0; a < N_PARAMETERS; a++)
        mean[a] = weight[a] = 0.0;
    mean[PAR_STEEPNESS] = START_STEEPNESS;
    mean[PAR_XX] = mean[PAR_YY] = 1.0;
    weight[PAR_PEAK] = 1.0 / square(PRIOR_PEAK);
    weight[PAR_FLOOR] = 1.0 / square(PRIOR_FLOOR);
    weight[PAR_STEEPNESS] = 1.0 / square(PRIOR_STEEPNESS);
    weight[PAR_XX] = weight[PAR_XY] = weight[PAR_YY] = 1.0 / square(PRIOR_SHAPE);
    copy(start, mean, N_PARAMETERS);
    double top = floor_priors(p, rows, scale, floor, weight);
    bool cut_off = top > (double)SENSOR_LIMIT - NEAR_LIMIT, full = false;
    for (int64_t k = 0; k < p; k++)
        if (value[k] >= SENSOR_LIMIT)
            full = full || (double)(column[k] * column[k] + row[k] * row[k]) <= scale * scale;
    mean[PAR_FLOOR] = start[PAR_FLOOR] = floor;
    mean[PAR_PEAK] = (cut_off ? PEAK_FACTOR_CLIPPED : PEAK_FACTOR) * MAX(top - floor, 1.0);
    start[PAR_PEAK] = mean[PAR_PEAK];
    fits->saturated[n] = full;
    if (full)
        return; /* a cut-off top shows nothing of its sides */
    start[PAR_FLOOR] = (floor > 0.0 ? floor : floor_below_black(p, value, read)) - HALO_DN;
    start[PAR_PEAK] = top - start[PAR_FLOOR];
    start_values(p, rows, scale, floor, top, start);
}
