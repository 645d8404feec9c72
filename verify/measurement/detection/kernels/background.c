/* Correct spots for the room that a bright camera shows behind them, and widen them by the rest.
 *
 * Model: to a spot's plane, polynomials of second and third order are added,
 *
 *     background = plane + c . b(u, w),   c ~ N(0, s^2),
 *     b = (u^2, u w, w^2, u^3, u^2 w, u w^2, w^3)
 *
 * with (u, w) the pixel's place from the spot's centre over the patch's radius. With D the
 * derivatives by the spot's parameters, r the residuals and B those by c, all over the pixels'
 * sigmas, A the information on the parameters,
 *
 *     S = B'B - B'D A^-1 D'B,   h = B'r - B'D A^-1 D'r,   c = (S + s^-2)^-1 h,   centre += pull c
 *
 *     symbol  meaning                                                                 unit
 *     s       curvature of the room over a patch, one for all spots of a picture      DN
 *     S, h    information and gradient of c, the spot's parameters following          DN^-2, DN^-1
 *     pull    -A^-1 D'B, the rows of x and y                                          px/DN
 *
 * s is averaged over AMPLITUDES by their evidence, the sum of (h c - ln |1 + s^2 S|) / 2. What is
 * finer than that is measured (surroundings.h): the correction and the fit together are linear in
 * the pixels, so the same weights on patches of the room show how far it would move a centre.
 * Where the room is below black there is nothing of it.
 */
#include "verify/measurement/detection/kernels/background.h"

#include "verify/core/kernels/linear_algebra.h"
#include "verify/core/kernels/scratch.h"
#include "verify/measurement/detection/kernels/fit.h"
#include "verify/measurement/detection/kernels/quality.h"

#define N_TERMS 7
#define N_RIGHT (N_TERMS + 1) /* residuals and terms; a multiple of four */
#define MIN_VISIBLE 0.5f /* share of the noise about a spot that clipping must leave: above black */
#define N_AMPLITUDES 9

/* DN, beside none at all */
static const double AMPLITUDES[N_AMPLITUDES] = {0.1, 0.2, 0.4, 0.8, 1.6, 3.2, 6.4, 12.8, 25.6};

/* What a spot shows of the room behind it. */
typedef struct {
    double noise; /* DN^2, of its pixels that show the room alone; 0 of a spot left alone */
    float *right; /* (8, p), its residuals, and the derivatives by the curvature's terms */
    /* how the parameters follow r and B, and the columns of x and y of A^-1 */
    double follow[N_PARAMETERS][N_RIGHT + 2];
    /* at each amplitude, (S + s^-2)^-1 times h and the pull */
    double solved[N_TERMS][3][N_AMPLITUDES];
    double own[2][3]; /* shift, px, and covariance, px^2 */
} Room;

/* Mean variance, DN^2, of a spot's pixels that show the room alone; 0 if it is below black. */
static double surroundings_noise(int64_t p, const float *rows)
{
    const float *used = rows + ROW_USED * pitch(p), *radius2 = rows + ROW_RADIUS2 * pitch(p);
    const float *shown = rows + ROW_VISIBLE * pitch(p), *spread = rows + ROW_VARIANCE * pitch(p);
    float visible = 0.0f, variance = 0.0f, count = 0.0f;
#pragma omp simd reduction(+ : visible, variance, count)
    for (int64_t k = 0; k < pitch(p); k++) {
        bool room = radius2[k] > NEIGHBOUR_RADIUS * NEIGHBOUR_RADIUS;
        float one = (used[k] > 0.0f) & room ? 1.0f : 0.0f;
        visible += one * shown[k];
        variance += one * spread[k];
        count += one;
    }
    return visible > MIN_VISIBLE * MAX(count, 1.0f) ? (double)(variance / count) : 0.0;
}

/* Fill in a spot's residuals, and the derivatives by the curvature's terms, `right` (8, p).
 *
 * `centre` (2,): the spot's parameters x and y. */
static void fill_right(const double *centre, int64_t p, const float *rows, float *restrict right)
{
    const float *column = rows + ROW_COLUMN * pitch(p), *row = rows + ROW_ROW * pitch(p);
    const float *floor_change = rows + PAR_FLOOR * pitch(p);
    /* the topmost pixel comes first */
    float scale = 1.0f / -row[0], x = (float)centre[0], y = (float)centre[1];
    memcpy(right, rows + ROW_RESIDUAL * pitch(p), sizeof(float) * (size_t)pitch(p));
#pragma omp simd
    for (int64_t k = 0; k < pitch(p); k++) {
        float u = (column[k] - x) * scale, w = (row[k] - y) * scale;
        float uu = floor_change[k] * u * u, ww = floor_change[k] * w * w;
        right[pitch(p) + k] = uu;
        right[2 * pitch(p) + k] = floor_change[k] * u * w;
        right[3 * pitch(p) + k] = ww;
        right[4 * pitch(p) + k] = uu * u;
        right[5 * pitch(p) + k] = uu * w;
        right[6 * pitch(p) + k] = ww * u;
        right[7 * pitch(p) + k] = ww * w;
    }
}

/* Fill in the lower Cholesky factors of S + s^-2, at all amplitudes at once: with one after the other a
 * picture takes 5 % longer. False where rounding leaves no S at one. */
static bool factor_each(double (*left)[N_RIGHT], double (*root)[N_TERMS][N_AMPLITUDES])
{
    bool definite = true;
    for (int i = 0; i < N_TERMS; i++) {
        for (int j = 0; j <= i; j++) {
            double *own = root[i][j];
            for (int k = 0; k < N_AMPLITUDES; k++)
                own[k] = left[i + 1][j + 1] + (i == j ? 1.0 / square(AMPLITUDES[k]) : 0.0);
            for (int c = 0; c < j; c++)
                for (int k = 0; k < N_AMPLITUDES; k++)
                    own[k] -= root[i][c][k] * root[j][c][k];
            for (int k = 0; k < N_AMPLITUDES; k++) {
                definite &= i > j || own[k] > 0.0;
                own[k] = i > j ? own[k] / root[j][j][k] : sqrt(MAX(own[k], 0.0));
            }
        }
    }
    return definite;
}

/* Solve in place for three vectors (7,) at each amplitude, by the factors. */
static void solve_all(double (*root)[N_TERMS][N_AMPLITUDES], double (*right)[3][N_AMPLITUDES])
{
    for (int turn = 0; turn < 2 * N_TERMS; turn++) { /* downwards, then upwards */
        bool down = turn < N_TERMS;
        int i = down ? turn : 2 * N_TERMS - 1 - turn;
        for (int column = 0; column < 3; column++) {
            double *own = right[i][column];
            for (int c = down ? 0 : i + 1; c < (down ? i : N_TERMS); c++) {
                const double *factors = down ? root[i][c] : root[c][i];
                for (int k = 0; k < N_AMPLITUDES; k++)
                    own[k] -= factors[k] * right[c][column][k];
            }
            for (int k = 0; k < N_AMPLITUDES; k++)
                own[k] /= root[i][i][k];
        }
    }
}

/* Fill in what a spot's curvature is at each amplitude, and add to their evidence (9,).
 *
 * `left` (8, 8), r and B with themselves, the spot's parameters following: h and S are in it.
 * Nothing is added, and no curvature found, where rounding leaves no S: of a spot far over the limit,
 * which hardly determines its own parameters. */
static void solve_amplitudes(double (*left)[N_RIGHT], Room *room, double *evidence)
{
    double root[N_TERMS][N_TERMS][N_AMPLITUDES];
    if (!factor_each(left, root))
        return;
    for (int c = 0; c < N_TERMS; c++)
        for (int k = 0; k < N_AMPLITUDES; k++) {
            room->solved[c][0][k] = left[c + 1][0];
            room->solved[c][1][k] = -room->follow[PAR_X][c + 1];
            room->solved[c][2][k] = -room->follow[PAR_Y][c + 1];
        }
    solve_all(root, room->solved);
    for (int k = 0; k < N_AMPLITUDES; k++) {
        double gain = 0.0, volume = 1.0;
        for (int c = 0; c < N_TERMS; c++) {
            gain += 0.5 * room->solved[c][0][k] * left[c + 1][0];
            volume *= AMPLITUDES[k] * root[c][c][k];
        }
        evidence[k] += gain - log(volume);
    }
}

/* Sum up what a spot shows of the room, and how likely curvature makes it: to `evidence` (9,), the
 * log-likelihood ratio of curvature of each amplitude to none, is added. */
static void sum_curvature(const Fits *fits, int64_t n, Room *room, double *evidence)
{
    double products[N_PARAMETERS][N_RIGHT], left[N_RIGHT][N_RIGHT];
    int64_t p = pixels_of(fits, n);
    bool precise = fits->saturated[n]; /* as in `normal_equations` */
    multiply_rows(N_PARAMETERS, N_RIGHT, p, rows_of(fits, n), room->right, precise, products[0]);
    multiply_rows(N_RIGHT, N_RIGHT, p, room->right, room->right, precise, left[0]);
    for (int a = 0; a < N_PARAMETERS; a++) {
        copy(room->follow[a], products[a], N_RIGHT);
        room->follow[a][N_RIGHT] = a == PAR_X ? 1.0 : 0.0;
        room->follow[a][N_RIGHT + 1] = a == PAR_Y ? 1.0 : 0.0;
    }
    solve_each(N_PARAMETERS, N_RIGHT + 2, fits->root + N_PARAMETERS * N_PARAMETERS * n,
               room->follow[0]);
    for (int a = 0; a < N_PARAMETERS; a++)
        for (int b = 0; b < N_RIGHT; b++)
            for (int c = 0; c < N_RIGHT; c++)
                left[b][c] -= products[a][b] * room->follow[a][c];
    solve_amplitudes(left, room, evidence);
}

/* Fill in the probability of each amplitude by its evidence; the rest is that of none. */
static void share_out(const double *evidence, double *share)
{
    double highest = 0.0, total = 0.0;
    for (int k = 0; k < N_AMPLITUDES; k++)
        highest = MAX(highest, evidence[k]);
    for (int k = 0; k < N_AMPLITUDES; k++) {
        share[k] = exp(evidence[k] - highest);
        total += share[k];
    }
    for (int k = 0; k < N_AMPLITUDES; k++)
        share[k] /= total + exp(-highest);
}

/* Average a spot's correction over amplitudes, each with its `share` (9,).
 *
 * Filled: `reach` (8, 2) and `factors` (10, 2), px, by which the shift follows r and B, and D. */
static void average_correction(Room *room, const double *share, double (*reach)[2],
                               double (*factors)[2])
{
    double (*own)[3] = room->own;
    memset(reach, 0, sizeof(double) * N_RIGHT * 2);
    for (int k = 0; k < N_AMPLITUDES; k++) {
        double moved[2] = {0.0, 0.0};
        for (int i = 0; i < 2; i++) {
            for (int c = 0; c < N_TERMS; c++) {
                moved[i] -= room->solved[c][0][k] * room->follow[i][c + 1];
                reach[c + 1][i] += share[k] * room->solved[c][1 + i][k];
            }
            own[i][0] += share[k] * moved[i];
        }
        for (int i = 0; i < 2; i++)
            for (int j = 0; j < 2; j++)
                own[i][1 + j] += share[k] * moved[i] * moved[j];
    }
    for (int i = 0; i < 2; i++) {
        for (int a = 0; a < N_PARAMETERS; a++) {
            factors[a][i] = 0.0;
            for (int c = 1; c < N_RIGHT; c++)
                factors[a][i] -= room->follow[a][c] * reach[c][i];
        }
        for (int j = 0; j < 2; j++) /* x and y are the first parameters */
            own[i][1 + j] += factors[j][i] - own[i][0] * own[j][0];
    }
}

/* Fill in by how much each pixel moves the centre, and what noise and curvature explain of the
 * squares of that.
 *
 * `factors` (10, 2) and `reach` (8, 2) as by `average_correction`. In double precision: of a spot far
 * over the limit the terms nearly cancel. */
static void find_weights(const Room *room, int64_t p, const float *restrict rows,
                         double (*factors)[2], double (*reach)[2], Response *response)
{
    const float *restrict right = room->right, *restrict used = rows + ROW_USED * pitch(p);
    const float *restrict variance = rows + ROW_VARIANCE * pitch(p);
    float *restrict weight = response->weight;
    double fit[N_PARAMETERS][2], whole[N_PARAMETERS][2], squares_x = 0.0, squares_y = 0.0;
    for (int a = 0; a < N_PARAMETERS; a++)
        for (int i = 0; i < 2; i++) {
            fit[a][i] = room->follow[a][N_RIGHT + i];
            whole[a][i] = fit[a][i] + factors[a][i];
        }
#pragma omp simd reduction(+ : squares_x, squares_y)
    for (int64_t k = 0; k < pitch(p); k++) {
        double fit_x = 0.0, fit_y = 0.0, whole_x = 0.0, whole_y = 0.0;
        float share = used[k] / variance[k], root = sqrtf(share);
        for (int a = 0; a < N_PARAMETERS; a++) {
            double change = (double)rows[a * pitch(p) + k];
            fit_x += fit[a][0] * change;
            fit_y += fit[a][1] * change;
            whole_x += whole[a][0] * change;
            whole_y += whole[a][1] * change;
        }
        for (int c = 0; c < N_RIGHT; c++) {
            double change = (double)right[c * pitch(p) + k];
            whole_x += reach[c][0] * change;
            whole_y += reach[c][1] * change;
        }
        squares_x += fit_x * fit_x * (double)share;
        squares_y += fit_y * fit_y * (double)share;
        weight[k] = (float)(whole_x * (double)root);
        weight[pitch(p) + k] = (float)(whole_y * (double)root);
    }
    response->explained[0] = squares_x * room->noise + room->own[0][1];
    response->explained[1] = squares_y * room->noise + room->own[1][2];
}

/* Find the curvature of the room at each amplitude, and how likely that is; see `sum_curvature`. */
static void find_curvature(const Fits *fits, int64_t m, const int64_t *kept, const double *assessed,
                           Room *rooms, double *evidence)
{
    for (int64_t k = 0; k < m; k++) {
        Room *room = rooms + k;
        int64_t n = kept[k], p = pixels_of(fits, n);
        if (assessed[N_COLUMNS * k + COL_MERGED] == 0.0)
            room->noise = surroundings_noise(p, rows_of(fits, n));
        if (room->noise > 0.0) {
            room->right = TAKE(float, N_RIGHT * pitch(p));
            fill_right(fits->parameters + N_PARAMETERS * n, p, rows_of(fits, n), room->right);
            sum_curvature(fits, n, room, evidence);
        }
    }
}

void correct_for_room(const Surroundings *around, const Fits *fits, int64_t m, const int64_t *kept,
                      const double *assessed, double *moments)
{
    Mark mark = scratch_mark();
    Room *rooms = TAKE(Room, m);
    Response *responses = TAKE(Response, m);
    double evidence[N_AMPLITUDES] = {0.0}, share[N_AMPLITUDES], *excess = TAKE(double, m);
    memset(rooms, 0, sizeof(Room) * (size_t)m);
    memset(responses, 0, sizeof(Response) * (size_t)m);
    find_curvature(fits, m, kept, assessed, rooms, evidence);
    share_out(evidence, share);
    for (int64_t k = 0; k < m; k++) {
        double reach[N_RIGHT][2], factors[N_PARAMETERS][2];
        Response *response = responses + k;
        int64_t p = pixels_of(fits, kept[k]);
        if (rooms[k].noise == 0.0)
            continue;
        response->weight = TAKE(float, 2 * pitch(p));
        average_correction(rooms + k, share, reach, factors);
        find_weights(rooms + k, p, rows_of(fits, kept[k]), factors, reach, response);
    }
    find_excess(around, fits, m, kept, responses, excess);
    for (int64_t k = 0; k < m; k++)
        for (int i = 0; i < 2; i++) {
            rooms[k].own[i][1 + i] += excess[k] * responses[k].explained[i];
            for (int at = 0; at < 3; at++)
                moments[6 * k + 3 * i + at] += rooms[k].own[i][at];
        }
    scratch_release(mark);
}
