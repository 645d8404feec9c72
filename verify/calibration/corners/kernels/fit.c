/* Fit a corner's crossing by Gauss-Newton with Levenberg's damping; say how well it is known.
 *
 * With r the pixels' residuals and J their derivatives by the 13 parameters, each step solves
 * (J'J + damping diag J'J) dp = J'r. Pixels that are no part of the corner are left out, and it is
 * fitted again. A calibration fits thousands of corners of hundreds of pixels.
 */
#include "verify/calibration/corners/kernels/model.h"
#include "verify/core/kernels/linear_algebra.h"
#include "verify/core/kernels/scratch.h"

#define START_BLUR 0.06        /* squares: wide enough to draw in a start that is some pixels off */
#define MIN_BLUR 0.7           /* px: what is sharper shows no difference in pixels */
#define MAX_LOG_BLUR 4.0       /* either way, of the log of a blur in px */
#define MAX_ITERATIONS 25      /* a good start takes three */
#define TOL_STEP 1e-3          /* px; the step after it is below 1e-5 */
#define TOL_GAIN 1e-5          /* of the sum of squares */
#define MAX_DEVIATION 0.5      /* of the contrast: what differs more (a border, dirt) is no part */
#define EDGE_SIGMA 0.5         /* px that an edge's pixels may be off: sharpening, saturation */
#define OUTLIER_SIGMA 5.0      /* sigma, and more than that */
#define MAD_OVER_SIGMA 0.67449 /* median of |x| over sigma, Gaussian */
#define N_REJECTIONS 2         /* the first fit was led astray by what it leaves out */
#define MIN_OWN_SHARE 0.6      /* of the pixels that must belong to the corner */
#define MIN_PIXELS 40          /* three a parameter */

/* Of a result: covariance of the centre where the residuals' variance is one, that variance (DN^2),
 * and the scatter of the centre's scores from cell to cell, found and expected. */
enum { COL_XX, COL_XY, COL_YY, COL_VARIANCE, COL_FOUND, COL_EXPECTED, N_COLUMNS };

enum { SQUARES = N_ROWS * N_ROWS - 1 }; /* among the products: of the residuals */

/* The model's rows (14, p) at some parameters, `stride` apart; the products (14, 14) of every row
 * with every other. */
typedef struct {
    int64_t stride;
    double *rows, *products;
} Expected;

static Expected take_expected(int64_t n)
{
    int64_t stride = 8 * ((n + 7) / 8 | 1); /* odd in cache lines: rows share no place in it */
    return (Expected){stride, TAKE(double, N_ROWS * stride), TAKE(double, N_ROWS * N_ROWS)};
}

/* Expect the pixels; four products of rows at once: what is loaded is used several times. */
static void expect(CornerPixels pixels, const double *edges, const double *p, Table table,
                   Expected at)
{
    predict_pixels(pixels, edges, p, table, at.stride, at.rows);
    for (int a = 0; a < N_ROWS; a++) {
        for (int first = 0; first <= a; first += 4) {
            int b = MIN(first, N_ROWS - 4);
            const double *x = at.rows + a * at.stride, *one = at.rows + b * at.stride;
            const double *two = one + at.stride, *three = two + at.stride;
            const double *four = three + at.stride;
            double x1 = 0.0, x2 = 0.0, x3 = 0.0, x4 = 0.0;
#pragma omp simd reduction(+ : x1, x2, x3, x4)
            for (int64_t k = 0; k < pixels.count; k++) {
                x1 += x[k] * one[k];
                x2 += x[k] * two[k];
                x3 += x[k] * three[k];
                x4 += x[k] * four[k];
            }
            double sum[4] = {x1, x2, x3, x4};
            for (int j = 0; j < 4; j++)
                at.products[a * N_ROWS + b + j] = at.products[(b + j) * N_ROWS + a] = sum[j];
        }
    }
}

/* Whether a step moves the place by next to nothing, and gains next to nothing. */
static bool is_small(const double *step, const double *products)
{
    double gain = 0.0;
    for (int a = 0; a < N_PARAMETERS; a++)
        gain += step[a] * products[ROW_RESIDUAL * N_ROWS + a];
    return MAX(fabs(step[PAR_X]), fabs(step[PAR_Y])) < TOL_STEP
        && gain < TOL_GAIN * products[SQUARES];
}

/* Factor the damped information (13, 13); false where it is singular. */
static bool factor_information(const double *products, double damping, double *root)
{
    double damped[N_PARAMETERS * N_PARAMETERS];
    for (int a = 0; a < N_PARAMETERS; a++) {
        copy(damped + a * N_PARAMETERS, products + a * N_ROWS, N_PARAMETERS);
        damped[a * N_PARAMETERS + a] *= 1.0 + damping;
    }
    return factor(N_PARAMETERS, damped, 0.0, root);
}

/* Find the parameters by Gauss-Newton with Levenberg's damping: p (13,) holds the start, and the
 * best met afterwards. Gives whether it settled; `best` is then the model within TOL_STEP of it. */
static bool converge(CornerPixels pixels, const double *edges, Table table, double *p,
                     Expected *best, Expected *tried)
{
    double step[N_PARAMETERS], trial[N_PARAMETERS], root[N_PARAMETERS * N_PARAMETERS];
    double damping = 1e-3;
    expect(pixels, edges, p, table, *best);
    for (int n = 0; n < MAX_ITERATIONS; n++) {
        if (!factor_information(best->products, damping, root))
            return false;
        copy(step, best->products + ROW_RESIDUAL * N_ROWS, N_PARAMETERS);
        solve(N_PARAMETERS, root, step);
        for (int a = 0; a < N_PARAMETERS; a++)
            trial[a] = p[a] + step[a];
        if (is_small(step, best->products) && damping < 1.0) {
            copy(p, trial, N_PARAMETERS); /* the picture there is the same */
            return true;
        }
        double away = MAX(MAX(fabs(trial[PAR_X]), fabs(trial[PAR_Y])), fabs(trial[PAR_SPREAD]));
        double blur = MAX(fabs(trial[PAR_BLUR_1]), fabs(trial[PAR_BLUR_2]));
        if (!(away < edges[EDGE_SCALE] && blur < MAX_LOG_BLUR)) { /* another corner, or no lens */
            damping *= 30.0;
            continue;
        }
        expect(pixels, edges, trial, table, *tried);
        bool better = tried->products[SQUARES] <= best->products[SQUARES];
        if (better) {
            Expected held = *best;
            *best = *tried;
            *tried = held;
            copy(p, trial, N_PARAMETERS);
        }
        damping = better ? damping / 10.0 : damping * 30.0;
    }
    return false;
}

/* Fill in which pixels (p,) are no part of the corner that was fitted; gives whether any is. */
static bool mark_strays(int64_t n, const double *p, Expected at, bool *stray)
{
    Mark mark = scratch_mark();
    double *residual = TAKE(double, n);
    for (int64_t k = 0; k < n; k++)
        residual[k] = fabs(at.rows[ROW_RESIDUAL * at.stride + k]);
    double spread = OUTLIER_SIGMA * median(residual, n) / MAD_OVER_SIGMA;
    double usual = MAX(MAX_DEVIATION * fabs(p[PAR_CONTRAST]), spread);
    bool any = false;
    for (int64_t k = 0; k < n; k++) {
        stray[k] = residual[k] > usual + EDGE_SIGMA * fabs(at.rows[PAR_SPREAD * at.stride + k]);
        any |= stray[k];
    }
    scratch_release(mark);
    return any;
}

/* Sum over the window's cells what the fit took of the centre's scores, and these, squared.
 *
 * A cell and its mirror image about the corner count as one, so what is even about the corner (the
 * blur's true shape, gamma), which moves the centre nowhere, cancels. */
static void sum_cells(CornerPixels pixels, Expected at, const double *inverse, double *spent,
                      double *scattered)
{
    enum { CELLS = N_CELLS / 2 + 1 };
    int64_t n = pixels.count;
    double taken[CELLS][2][N_ROWS] = {0}; /* by the fit, and the scores behind */
    Mark mark = scratch_mark();
    double *restrict by_x = TAKE(double, n), *restrict by_y = TAKE(double, n);
    clear(by_x, n); /* d centre / d pixel */
    clear(by_y, n);
    for (int a = 0; a < N_PARAMETERS; a++) {
        const double *row = at.rows + a * at.stride;
#pragma omp simd
        for (int64_t k = 0; k < n; k++) {
            by_x[k] += inverse[a] * row[k];
            by_y[k] += inverse[N_PARAMETERS + a] * row[k];
        }
    }
    for (int64_t k = 0; k < n; k++) {
        double(*own)[N_ROWS] = taken[(int)pixels.cell[k]];
        for (int a = 0; a < N_ROWS; a++) {
            own[0][a] += by_x[k] * at.rows[a * at.stride + k];
            own[1][a] += by_y[k] * at.rows[a * at.stride + k];
        }
    }
    scratch_release(mark);
    *spent = *scattered = 0.0;
    for (int cell = 0; cell < CELLS; cell++) {
        for (int axis = 0; axis < 2; axis++) {
            const double *own = taken[cell][axis];
            for (int i = 0; i < N_PARAMETERS; i++) {
                double form = 0.0;
                for (int j = 0; j < N_PARAMETERS; j++)
                    form += inverse[i * N_PARAMETERS + j] * own[j];
                *spent += own[i] * form;
            }
            *scattered += square(own[ROW_RESIDUAL]);
        }
    }
}

/* Fill in the centre's covariance, and how its scores scatter over the window.
 *
 * Were residuals independent, the sum over cells of the centre's squared scores would be what the
 * information says, less what the fit took. JPEG, demosaicing and sharpening tie neighbours
 * together: then it is more. (Sandwich estimator with clusters; Liang and Zeger, Biometrika 73,
 * 1986, with the expectation of the meat taken exactly.) */
static bool centre_covariance(CornerPixels pixels, Expected at, double *result)
{
    double root[N_PARAMETERS * N_PARAMETERS], inverse[N_PARAMETERS * N_PARAMETERS];
    double spent, scattered;
    if (!factor_information(at.products, 0.0, root))
        return false;
    invert(N_PARAMETERS, root, inverse);
    sum_cells(pixels, at, inverse, &spent, &scattered);
    result[COL_XX] = inverse[0];
    result[COL_XY] = inverse[PAR_Y];
    result[COL_YY] = inverse[PAR_Y * N_PARAMETERS + PAR_Y];
    double unit = result[COL_XX] + result[COL_YY]; /* all corners of a view speak alike */
    double variance = at.products[SQUARES] / (double)(pixels.count - N_PARAMETERS);
    result[COL_VARIANCE] = variance;
    result[COL_FOUND] = scattered / (unit * variance);
    result[COL_EXPECTED] = 1.0 - spent / unit;
    return true;
}

/* Fit a corner's pixels by the start in p (13,); gives whether there is one. */
static bool fit_crossing(CornerPixels pixels, const double *jacobian, const double *edges,
                         Table table, double *p, double *result)
{
    if (pixels.count < MIN_PIXELS)
        return false;
    Expected at = take_expected(pixels.count), tried = take_expected(pixels.count);
    bool *stray = TAKE(bool, pixels.count);
    for (int n = 0;; n++) {
        if (!converge(pixels, edges, table, p, &at, &tried))
            return false;
        if (n == N_REJECTIONS || !mark_strays(pixels.count, p, at, stray))
            break;
        CornerPixels own = keep_clear(pixels, stray);
        if ((double)own.count < MAX(MIN_PIXELS, MIN_OWN_SHARE * (double)pixels.count))
            return false; /* most of it is something else */
        pixels = own;
    }
    double determinant = jacobian[0] * jacobian[3] - jacobian[1] * jacobian[2];
    double u = (p[PAR_X] * jacobian[3] - p[PAR_Y] * jacobian[1]) / determinant;
    double v = (p[PAR_Y] * jacobian[0] - p[PAR_X] * jacobian[2]) / determinant;
    bool inside = MAX(fabs(u), fabs(v)) <= HALF_WINDOW / 2.0; /* well within the window */
    return inside && centre_covariance(pixels, at, result);
}

/* Fit the corners of a view, all of whose pixels weigh the same.
 *
 * Expected centres (n, 2), px, good to a tenth of a square; d px / d squares (n, 2, 2), columns
 * along the board's x and y; d^2 px / d squares^2 (n, 2, 2), likewise; `markers` (n, 2) as for
 * `window_pixels`. Parameters (n, 13) and results (n, 6) are filled where there is a crossing, and
 * `fitted` (n,) says where; where it is true beforehand the parameters are of an earlier fit, whose
 * centre is the expected one. */
static int64_t fit_crossings(Picture grey, int64_t n, const double *centres,
                             const double *jacobians, const double *bends, const double *markers,
                             Table table, bool *fitted, double *parameters, double *results)
{
    double edges[N_EDGE_VALUES], usual[3];
    bool known = false; /* the lens blurs the next corner much alike */
    for (int64_t i = 0; i < n; i++) {
        Mark mark = scratch_mark();
        double *p = parameters + i * N_PARAMETERS, *result = results + i * N_COLUMNS;
        const double *jacobian = jacobians + 4 * i;
        CornerPixels pixels = window_pixels(grey, centres + 2 * i, jacobian, markers + 2 * i);
        fill_edges(jacobian, bends + 4 * i, edges);
        if (fitted[i]) {
            p[PAR_X] = p[PAR_Y] = 0.0;
            fitted[i] = fit_crossing(pixels, jacobian, edges, table, p, result);
            scratch_release(mark);
            continue;
        }
        if (known) {
            start_values(pixels, edges, usual, p);
            fitted[i] = fit_crossing(pixels, jacobian, edges, table, p, result);
        }
        if (!fitted[i]) {
            double blur = log(MAX(START_BLUR * edges[EDGE_SCALE], MIN_BLUR));
            start_values(pixels, edges, (double[]){blur, blur, 0.0}, p);
            fitted[i] = fit_crossing(pixels, jacobian, edges, table, p, result);
        }
        if (fitted[i]) {
            known = true;
            usual[0] = p[PAR_BLUR_1];
            usual[1] = p[PAR_BLUR_2];
            usual[2] = copysign(p[PAR_SPREAD], p[PAR_SPREAD] * p[PAR_CONTRAST]);
        }
        scratch_release(mark);
    }
    return 0;
}

int64_t entry_fit_crossings(int64_t height, int64_t width, const uint8_t *grey, int64_t n,
                            const double *centres, const double *jacobians, const double *bends,
                            const double *markers, int64_t n_steps, const double *steps,
                            bool *fitted, double *parameters, double *results)
{
    Picture picture = {height, width, grey};
    Table table = table_of(n_steps, steps);
    GUARDED(fit_crossings(picture, n, centres, jacobians, bends, markers, table, fitted,
                          parameters, results));
}
