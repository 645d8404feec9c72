/* Correct spot centres for an object that hides a sliver of the LED's rim.
 *
 * Model, to first order in the depth d of a bite in direction k (24 directions round the rim):
 *
 *     log L(d) = g_k d - i_k d^2 / 2,   d ~ half-normal(PRIOR_DEPTH),   d >= 0
 *     centre   = fitted centre + E[d] pull_k, averaged over no bite, one of the spot's own, and
 *                bites on one side of all spots, by their posterior probabilities
 *
 *     symbol  meaning                                                        unit
 *     d       depth of the bite                                              half-widths
 *     g, i    gradient and information of the log-likelihood                 half-widths^-1, ^-2
 *     pull    shift of the centre a unit of depth, (2,)                      px
 *
 * A bite adds harmonics to the rim's radius: the first shifts the centre, the second changes the
 * ellipse, the third and higher ones, which no whole disc has, reveal it. One spot seldom shows
 * them above its noise, but an object hides the same side of all LEDs of a marker. No threshold
 * decides; what remains uncertain enlarges the covariance.
 *
 * Source: Hoeting et al., Bayesian model averaging: a tutorial, Statistical Science 14, 1999.
 *
 * A bite of depth b in direction s lowers pixel k by b v_k(s). With D the derivatives by the spot's
 * parameters and r the residual, all over the pixels' sigmas, the parameters eliminated,
 *
 *     i = v'v - v'D (D'D)^-1 D'v,  g = v'r - r'D (D'D)^-1 D'v
 */
#include "verify/measurement/detection/kernels/occlusion.h"

#include "verify/core/kernels/linear_algebra.h"
#include "verify/core/kernels/scratch.h"
#include "verify/measurement/detection/kernels/quality.h"

#define PI 3.14159265358979323846
/* half-widths, scale of what is expected; far deeper ones show without a prior */
#define PRIOR_DEPTH 0.05
#define P_SHARED 0.1     /* prior probability that something hides one side of an image's LEDs */
#define P_OCCLUDED 0.8   /* of an LED's being bitten then */
#define P_SINGLE 0.02    /* of an LED's being bitten, where no side is shared */
#define MIN_Z (-5.0)     /* sigma: below, a continued fraction gives the normal law's tail */
#define N_FRACTIONS 24   /* of it: good to rounding */
#define MIN_RADIUS2 1e-18f  /* half-widths^2: nearer the very centre no bite changes anything */
#define OCCLUSION_WIDTH 0.3 /* rad, standard deviation: a stalk of a third to a half of its LED */
#define RIM_RADIUS2 3.24f   /* half-widths^2: no rim beyond */
/* Logarithm; a Gaussian's is 0.33. Nearer to it, what an edge leaves of an LED is stretched alone,
 * like one seen at an angle: a bite's chi^2 is 3 to 12, as it is by chance. */
#define MIN_STEEPNESS 0.39
#define MIN_LEFT 0.05 /* share of a bite's information that the fit's own parameters must leave */
#define BLOCK 128     /* pixels that are summed in single precision */
#define GROUP 8       /* directions that are summed up together */
#define POWER 32      /* of a series, that is an exponential: a power of two */
#define N_TERMS 8     /* of it: good to rounding up to 11, its largest argument */

/* Of the series, the highest power first. */
static const float SERIES[N_TERMS] = {1.0f / 5040.0f, 1.0f / 720.0f, 1.0f / 120.0f, 1.0f / 24.0f,
                                      1.0f / 6.0f, 0.5f, 1.0f, 1.0f};

/* Products with each bite: of the whitened rows, and its own square. */
enum { ROW_BITE = N_WHITENED, N_SUMS };

/* Pixels on the rim of a spot and inside, at most BLOCK: their places among all of its pixels; how much
 * each sinks, (24,), by a bite in each direction, per depth and over its sigma. */
typedef struct {
    int64_t count, place[BLOCK];
    float sunk[BLOCK][N_DIRECTIONS];
} Rim;

/* Directions (24,) over the bump's squared width and POWER. */
static float along[N_DIRECTIONS], across[N_DIRECTIONS];

__attribute__((constructor)) static void tabulate_directions(void)
{
    double sharp = 1.0 / (POWER * square(OCCLUSION_WIDTH));
    for (int side = 0; side < N_DIRECTIONS; side++) {
        along[side] = (float)(sharp * cos(2.0 * PI * side / N_DIRECTIONS));
        across[side] = (float)(sharp * sin(2.0 * PI * side / N_DIRECTIONS));
    }
}

/* Fill in how much a rim's pixels sink; a bite falls off on both sides as von Mises' bump, a Gaussian
 * round a circle.
 *
 * `twice`, DN: the peak times the bump's constant factor. The exponential is a series, which the
 * processor does for several directions at once: with expf, a picture takes 8 % longer. */
static void sink_pixels(float twice, int64_t p, const float *rows, Rim *rim)
{
    for (int64_t n = 0; n < rim->count; n++) {
        int64_t k = rim->place[n];
        float u = rows[ROW_U * pitch(p) + k], w = rows[ROW_W * pitch(p) + k];
        float scale = 1.0f / sqrtf(MAX(u * u + w * w, MIN_RADIUS2));
        /* a smaller radius is a larger t: d(t^2) = 2 t^2 times the relative depth; what shows of it, as
         * of the floor's change */
        float depth = twice * rows[ROW_SLOPE * pitch(p) + k] * rows[ROW_RADIUS2 * pitch(p) + k] *
                      rows[PAR_FLOOR * pitch(p) + k];
        for (int side = 0; side < N_DIRECTIONS; side++) {
            float z = scale * (along[side] * u + across[side] * w), bump = SERIES[0];
            for (int term = 1; term < N_TERMS; term++)
                bump = SERIES[term] + z * bump;
            for (int power = 1; power < POWER; power *= 2)
                bump *= bump;
            rim->sunk[n][side] = depth * bump;
        }
    }
}

/* Add a rim's pixels to `totals` (12, 24). A few directions at a time, whose sums the processor holds:
 * with all at once a picture takes 4 % longer. */
static void add_rim(int64_t p, const float *rows, const Rim *rim, double (*totals)[N_DIRECTIONS])
{
    for (int first = 0; first < N_DIRECTIONS; first += GROUP) {
        float sums[N_SUMS][GROUP] = {{0.0f}};
        for (int64_t n = 0; n < rim->count; n++) {
            const float *sunk = rim->sunk[n] + first, *row = rows + rim->place[n];
#pragma GCC unroll 12
            for (int a = 0; a < N_SUMS; a++) {
                #pragma omp simd
                for (int side = 0; side < GROUP; side++)
                    sums[a][side] += sunk[side] * (a == ROW_BITE ? sunk[side] : row[a * pitch(p)]);
            }
        }
        for (int a = 0; a < N_SUMS; a++)
            for (int side = 0; side < GROUP; side++)
                totals[a][first + side] += (double)sums[a][side];
    }
}

/* Fill in `totals` (12, 24) of the pixels on the rim and inside. `peak`, DN; `rows` (25, p). */
static void sum_bites(double peak, int64_t p, const float *rows, double (*totals)[N_DIRECTIONS])
{
    float twice = (float)(2.0 * peak * exp(-1.0 / square(OCCLUSION_WIDTH)));
    Rim rim;
    memset(totals, 0, sizeof(double) * N_SUMS * N_DIRECTIONS);
    for (int64_t k = 0; k < p;) {
        for (rim.count = 0; k < p && rim.count < BLOCK; k++) {
            rim.place[rim.count] = k;
            rim.count += rows[ROW_RADIUS2 * pitch(p) + k] < RIM_RADIUS2;
        }
        sink_pixels(twice, p, rows, &rim);
        add_rim(p, rows, &rim, totals);
    }
}

/* Score bites in each direction by the residuals of a fit.
 *
 * `worth`: by which unmodelled errors make the pixels worth less; `score` (4, 24), filled where
 * enough is left: gradient, information, pull in x and in y. */
static void score_bites(const Fits *fits, int64_t n, double worth, double (*score)[N_DIRECTIONS])
{
    double totals[N_SUMS][N_DIRECTIONS], *whole = totals[ROW_BITE];
    double follow[N_PARAMETERS][N_DIRECTIONS];
    const double *gradient = fits->gradient + N_PARAMETERS * n;
    sum_bites(fits->parameters[N_PARAMETERS * n + PAR_PEAK], pixels_of(fits, n), rows_of(fits, n),
              totals);
    copy(follow[0], totals[0], N_PARAMETERS * N_DIRECTIONS);
    solve_each(N_PARAMETERS, N_DIRECTIONS, fits->root + N_PARAMETERS * N_PARAMETERS * n, follow[0]);
    for (int side = 0; side < N_DIRECTIONS; side++) {
        double left = whole[side], slope = totals[ROW_RESIDUAL][side];
        for (int a = 0; a < N_PARAMETERS; a++) {
            left -= totals[a][side] * follow[a][side];
            slope -= gradient[a] * follow[a][side];
        }
        if (left > MIN_LEFT * whole[side]) {
            score[0][side] = slope / worth;
            score[1][side] = left / worth;
            score[2][side] = -follow[PAR_X][side];
            score[3][side] = -follow[PAR_Y][side];
        }
    }
}

/* Logarithm of the share of a standard normal variable below z, over exp(-z^2/2). */
static double log_scaled_law(double z)
{
    if (z > MIN_Z)
        return log(0.5 * erfc(-z * sqrt(0.5))) + z * z / 2.0;
    double below = -z;
    for (int k = N_FRACTIONS; k > 0; k--)
        below = k / below - z;
    return -log(below * sqrt(2.0 * PI));
}

/* Suppose a bite of unknown depth.
 *
 * The half-normal prior and the Gaussian likelihood make a normal law cut off at 0. Filled: the
 * log-likelihood ratio of a bite to none; the depth's posterior mean and mean square. */
static void depth_posterior(double gradient, double information, double *evidence, double *depth,
                            double *mean_square)
{
    double sigma = 1.0 / sqrt(information + 1.0 / (PRIOR_DEPTH * PRIOR_DEPTH));
    double z = gradient * sigma, cut_off = log_scaled_law(z);
    double excess = z + exp(-cut_off) / sqrt(2.0 * PI);
    *evidence = log(2.0 / PRIOR_DEPTH * sigma) + cut_off;
    *depth = sigma * excess;
    *mean_square = sigma * sigma * (1.0 + z * excess);
}

/* Logarithm of exp(a) + exp(b). */
static double log_add(double a, double b)
{
    return MAX(a, b) + log1p(exp(-fabs(a - b)));
}

/* Logarithm of the sum of exp(v), of (24,). */
static double log_sum(const double *values)
{
    double most = -INFINITY, total = 0.0;
    for (int side = 0; side < N_DIRECTIONS; side++)
        most = MAX(most, values[side]);
    for (int side = 0; side < N_DIRECTIONS; side++)
        total += exp(values[side] - most);
    return most + log(total);
}

/* Fill in the posterior probability of each of m spots' bite in each direction, (m, 24).
 *
 * Shared out among no bite, one of each spot's own, and bites on one side of all spots. `evidence`
 * (m, 24): log-likelihood ratio of each spot's bite in each direction to none. */
static void occlusion_probability(int64_t m, const double *evidence, double *probability)
{
    Mark mark = scratch_mark();
    double *free = TAKE(double, m), *either = TAKE(double, m * N_DIRECTIONS), sides[N_DIRECTIONS];
    double alone = log(1.0 - P_SHARED), own = log(P_SINGLE / N_DIRECTIONS);
    double hit = log(P_OCCLUDED), missed = log(1.0 - P_OCCLUDED), whole = log(1.0 - P_SINGLE);
    for (int side = 0; side < N_DIRECTIONS; side++)
        sides[side] = log(P_SHARED / N_DIRECTIONS);
    for (int64_t n = 0; n < m; n++) {
        free[n] = log_add(whole, own + log_sum(evidence + n * N_DIRECTIONS));
        alone += free[n];
        for (int side = 0; side < N_DIRECTIONS; side++) {
            int64_t at = n * N_DIRECTIONS + side;
            either[at] = log_add(missed, hit + evidence[at]);
            sides[side] += either[at];
        }
    }
    double total = log_add(alone, log_sum(sides));
    for (int64_t n = 0; n < m; n++) {
        for (int side = 0; side < N_DIRECTIONS; side++) {
            int64_t at = n * N_DIRECTIONS + side;
            probability[at] = exp(sides[side] - total + hit + evidence[at] - either[at]) +
                              exp(alone - total + own + evidence[at] - free[n]);
        }
    }
    scratch_release(mark);
}

void score_spots(const Fits *fits, int64_t m, const int64_t *kept, const double *assessed,
                 double *score, double *asymmetry)
{
    memset(score, 0, sizeof(double) * (size_t)(m * 4 * N_DIRECTIONS));
    for (int64_t n = 0; n < m; n++) {
        const double *row = assessed + N_COLUMNS * n;
        double (*bites)[N_DIRECTIONS] = (double (*)[N_DIRECTIONS])score + 4 * n;
        asymmetry[n] = 0.0;
        if (row[COL_SATURATED] + row[COL_MERGED] > 0.0)
            continue;
        /* where the reduced chi^2 is above 1, unmodelled errors make the pixels worth less */
        double worth = MAX(row[COL_MISFIT], 1.0);
        score_bites(fits, kept[n], worth, bites);
        for (int side = 0; side < N_DIRECTIONS; side++) {
            double chi2 = worth * square(bites[0][side]) / bites[1][side];
            asymmetry[n] = MAX(asymmetry[n], bites[0][side] > 0.0 ? chi2 : 0.0);
        }
        if (fits->parameters[N_PARAMETERS * kept[n] + PAR_STEEPNESS] < MIN_STEEPNESS)
            asymmetry[n] = INFINITY;
    }
}

void correct_for_bites(int64_t m, const double *score, const double *assessed, double *moments)
{
    Mark mark = scratch_mark();
    int64_t all = m * N_DIRECTIONS;
    double *evidence = TAKE(double, all), *depth = TAKE(double, all);
    double *mean_square = TAKE(double, all), *probability = TAKE(double, all);
    for (int64_t at = 0; at < all; at++) {
        int64_t n = at / N_DIRECTIONS;
        const double *gradient = score + 3 * N_DIRECTIONS * n + at;
        bool none = assessed[N_COLUMNS * n + COL_MERGED] > 0.0;
        depth_posterior(none ? 0.0 : gradient[0], none ? 0.0 : gradient[N_DIRECTIONS],
                        evidence + at, depth + at, mean_square + at);
    }
    occlusion_probability(m, evidence, probability);
    for (int64_t n = 0; n < m; n++) {
        const double *pull = score + (4 * n + 2) * N_DIRECTIONS;
        double *moment = moments + 6 * n, shift[2] = {0.0, 0.0};
        if (assessed[N_COLUMNS * n + COL_MERGED] > 0.0)
            continue;
        for (int side = 0; side < N_DIRECTIONS; side++) {
            int64_t at = n * N_DIRECTIONS + side;
            double to[2] = {pull[side], pull[N_DIRECTIONS + side]};
            for (int i = 0; i < 2; i++) {
                shift[i] += probability[at] * depth[at] * to[i];
                for (int j = 0; j < 2; j++)
                    moment[3 * i + 1 + j] += probability[at] * mean_square[at] * to[i] * to[j];
            }
        }
        for (int i = 0; i < 2; i++) {
            moment[3 * i] += shift[i];
            for (int j = 0; j < 2; j++)
                moment[3 * i + 1 + j] -= shift[i] * shift[j];
        }
    }
    scratch_release(mark);
}

/* `found` (3,), filled: log-likelihood ratio, posterior mean and mean square of a bite's depth. */
int64_t entry_depth_posterior(double gradient, double information, double *found)
{
    depth_posterior(gradient, information, found, found + 1, found + 2);
    return 0;
}
