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
 * finer than that is measured: the correction and the fit together are linear in the pixels, so the
 * same weights on N_AROUND patches of the room beside each spot show how far it would move a
 * centre. Their median square over what noise and curvature explain, of all spots of a picture,
 * adds the excess; a spot's own mean square does where it is MAX_OWN times that.
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
#define N_AROUND 8      /* patches of the room about each spot, two radii away */
#define MIN_AROUND 12   /* responses, two a patch, of all spots of a picture: fewer show nothing */
#define MIN_TEXTURE 6.0 /* of that median over what is explained, where patches have dim lights */
#define MAX_DIM 0.5     /* of a spot's peak: a light that is less may be texture of the room */
#define MAX_OWN 3.0     /* of the picture's: a spot's own surroundings move it more than chance */
#define EIGHTH_TURN 0.7853981633974483 /* rad */
#define MEDIAN_CHI2 0.4549 /* of chi^2 with one degree of freedom */

/* DN, beside none at all */
static const double AMPLITUDES[N_AMPLITUDES] = {0.1, 0.2, 0.4, 0.8, 1.6, 3.2, 6.4, 12.8, 25.6};

/* What a spot shows of the room behind it. */
typedef struct {
    double noise; /* DN^2, of its pixels that show the room alone; 0 of a spot left alone */
    float *right; /* (8, p), its residuals, and the derivatives by the curvature's terms */
    /* how the parameters follow r and B, and the columns of x and y of A^-1 */
    double follow[N_PARAMETERS][N_RIGHT + 2];
    /* at each amplitude, (S + s^-2)^-1 times h and the pull */
    double solved[N_AMPLITUDES][N_TERMS][3];
    double own[2][3];          /* shift, px, and covariance, px^2 */
    double moved[N_AROUND][2]; /* px, by patches beside it; NaN where there is none */
    bool dim[N_AROUND];        /* which of them a dim light reaches */
    double explained[2];       /* px^2, of their squares */
} Room;

/* Mean variance, DN^2, of a spot's pixels that show the room alone; 0 if it is below black. */
static double surroundings_noise(int64_t p, const float *rows)
{
    const float *used = rows + ROW_USED * p, *radius2 = rows + ROW_RADIUS2 * p;
    const float *shown = rows + ROW_VISIBLE * p, *spread = rows + ROW_VARIANCE * p;
    float visible = 0.0f, variance = 0.0f, count = 0.0f;
#pragma omp simd reduction(+ : visible, variance, count)
    for (int64_t k = 0; k < p; k++) {
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
    const float *column = rows + ROW_COLUMN * p, *row = rows + ROW_ROW * p;
    const float *floor_change = rows + PAR_FLOOR * p;
    /* the topmost pixel comes first */
    float scale = 1.0f / -row[0], x = (float)centre[0], y = (float)centre[1];
    memcpy(right, rows + ROW_RESIDUAL * p, sizeof(float) * (size_t)p);
#pragma omp simd
    for (int64_t k = 0; k < p; k++) {
        float u = (column[k] - x) * scale, w = (row[k] - y) * scale;
        float uu = floor_change[k] * u * u, ww = floor_change[k] * w * w;
        right[p + k] = uu;
        right[2 * p + k] = floor_change[k] * u * w;
        right[3 * p + k] = ww;
        right[4 * p + k] = uu * u;
        right[5 * p + k] = uu * w;
        right[6 * p + k] = ww * u;
        right[7 * p + k] = ww * w;
    }
}

/* Fill in what a spot's curvature is at each amplitude, and add to their evidence (9,).
 *
 * `left` (8, 8), r and B with themselves, the spot's parameters following: h and S are in it.
 * False, and nothing added, where rounding leaves no S: of a spot far over the limit, which hardly
 * determines its own parameters. */
static bool solve_amplitudes(double (*left)[N_RIGHT], Room *room, double *evidence)
{
    double inner[N_TERMS][N_TERMS], root[N_TERMS][N_TERMS], known[N_TERMS][3];
    double gain[N_AMPLITUDES] = {0.0};
    for (int i = 0; i < N_TERMS; i++) {
        copy(inner[i], left[i + 1] + 1, N_TERMS);
        known[i][0] = left[i + 1][0];
        known[i][1] = -room->follow[PAR_X][i + 1];
        known[i][2] = -room->follow[PAR_Y][i + 1];
    }
    for (int k = 0; k < N_AMPLITUDES; k++) {
        double (*solved)[3] = room->solved[k], volume = 1.0;
        if (!factor(N_TERMS, inner[0], -1.0 / square(AMPLITUDES[k]), root[0]))
            return false;
        copy(solved[0], known[0], 3 * N_TERMS);
        solve_each(N_TERMS, 3, root[0], solved[0]);
        for (int c = 0; c < N_TERMS; c++) {
            gain[k] += 0.5 * solved[c][0] * known[c][0];
            volume *= AMPLITUDES[k] * root[c][c];
        }
        gain[k] -= log(volume);
    }
    for (int k = 0; k < N_AMPLITUDES; k++)
        evidence[k] += gain[k];
    return true;
}

/* Sum up what a spot shows of the room, and how likely curvature makes it: to `evidence` (9,), the
 * log-likelihood ratio of curvature of each amplitude to none, is added. False as of
 * `solve_amplitudes`. */
static bool sum_curvature(const Fits *fits, int64_t n, Room *room, double *evidence)
{
    double root[N_PARAMETERS * N_PARAMETERS], products[N_PARAMETERS][N_RIGHT];
    double left[N_RIGHT][N_RIGHT];
    int64_t p = pixels_of(fits, n);
    bool precise = fits->saturated[n]; /* as in `normal_equations` */
    multiply_rows(N_PARAMETERS, N_RIGHT, p, rows_of(fits, n), room->right, precise, products[0]);
    multiply_rows(N_RIGHT, N_RIGHT, p, room->right, room->right, precise, left[0]);
    const double *information = fits->information + N_PARAMETERS * N_PARAMETERS * n;
    factor(N_PARAMETERS, information, -MIN_INFORMATION, root);
    for (int a = 0; a < N_PARAMETERS; a++) {
        copy(room->follow[a], products[a], N_RIGHT);
        room->follow[a][N_RIGHT] = a == PAR_X ? 1.0 : 0.0;
        room->follow[a][N_RIGHT + 1] = a == PAR_Y ? 1.0 : 0.0;
    }
    solve_each(N_PARAMETERS, N_RIGHT + 2, root, room->follow[0]);
    for (int a = 0; a < N_PARAMETERS; a++)
        for (int b = 0; b < N_RIGHT; b++)
            for (int c = 0; c < N_RIGHT; c++)
                left[b][c] -= products[a][b] * room->follow[a][c];
    return solve_amplitudes(left, room, evidence);
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
                moved[i] -= room->solved[k][c][0] * room->follow[i][c + 1];
                reach[c + 1][i] += share[k] * room->solved[k][c][1 + i];
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

/* Add m rows (m, p), each times its two factors (m, 2), to both of `total` (2, p).
 *
 * In double precision: of a spot far over the limit they nearly cancel. */
static void add_rows(int m, double (*factors)[2], int64_t p, const float *rows,
                     double *restrict total)
{
    for (int a = 0; a < m; a++) {
#pragma omp simd
        for (int64_t k = 0; k < p; k++) {
            total[k] += factors[a][0] * (double)rows[a * p + k];
            total[p + k] += factors[a][1] * (double)rows[a * p + k];
        }
    }
}

/* Fill in by how much each pixel moves the centre, px/DN, `weight` (2, p), and what explains that.
 *
 * `factors` (10, 2) and `reach` (8, 2) as by `average_correction`. Less their mean, as the level of
 * the room moves nothing. */
static void find_weights(Room *room, int64_t p, const float *rows, double (*factors)[2],
                         double (*reach)[2], double *weight)
{
    const float *used = rows + ROW_USED * p, *variance = rows + ROW_VARIANCE * p;
    double direct[N_PARAMETERS][2];
    for (int a = 0; a < N_PARAMETERS; a++)
        copy(direct[a], room->follow[a] + N_RIGHT, 2);
    memset(weight, 0, sizeof(double) * (size_t)(2 * p));
    add_rows(N_PARAMETERS, direct, p, rows, weight);
    for (int i = 0; i < 2; i++) {
        double squares = 0.0;
#pragma omp simd reduction(+ : squares)
        for (int64_t k = 0; k < p; k++)
            squares += square(weight[i * p + k]) * (double)(used[k] / variance[k]);
        room->explained[i] = squares * room->noise + room->own[i][1 + i];
    }
    add_rows(N_PARAMETERS, factors, p, rows, weight);
    add_rows(N_RIGHT, reach, p, room->right, weight);
    for (int i = 0; i < 2; i++) {
        double total = 0.0;
#pragma omp simd reduction(+ : total)
        for (int64_t k = 0; k < p; k++) {
            weight[i * p + k] *= (double)sqrtf(used[k] / variance[k]);
            total += weight[i * p + k];
        }
        for (int64_t k = 0; k < p; k++)
            weight[i * p + k] -= total / (double)p;
    }
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
 * are dim beside the spot; `dim`, filled: whether by one of those.
 *
 * `lights` (l, 4): place and half width, px, and contrast, DN, of all; `bright`, DN. */
static bool is_clear(const Picture *picture, int64_t l, const double *lights, int64_t x, int64_t y,
                     int64_t radius, double bright, bool *dim)
{
    *dim = false;
    if (x < radius || x >= picture->width - radius || y < radius || y >= picture->height - radius)
        return false;
    for (int64_t k = 0; k < l; k++) {
        const double *light = lights + 4 * k;
        double reach = (double)radius + PATCH_REACH * light[2];
        if (square((double)x - light[0]) + square((double)y - light[1]) <= square(reach)) {
            *dim = true;
            if (!(light[3] < bright))
                return false;
        }
    }
    return true;
}

/* Say what patches of the room beside a spot would move its centre by.
 *
 * `lights` (l, 4) as for `is_clear`; `weight` (2, p), of the pixels. */
static void look_around(const Picture *picture, int64_t l, const double *lights, const Fits *fits,
                        int64_t n, const double *weight, Room *room)
{
    Mark mark = scratch_mark();
    const float *rows = rows_of(fits, n);
    int64_t p = pixels_of(fits, n), depth = picture->channels, size = depth * p;
    int64_t radius = -(int64_t)rows[ROW_ROW * p]; /* the topmost pixel comes first */
    double peak = fits->parameters[N_PARAMETERS * n + PAR_PEAK];
    double bright = MAX_DIM * MIN(peak, (double)SENSOR_LIMIT), channel[3] = {1.0};
    double *spread = TAKE(double, 2 * size);
    uint8_t *bytes = TAKE(uint8_t, size);
    if (depth > 1)
        channel_weights(fits->colour + 3 * n, channel);
    for (int64_t k = 0; k < 2 * p; k++)
        for (int64_t c = 0; c < depth; c++)
            spread[depth * k + c] = channel[c] * weight[k];
    for (int side = 0; side < N_AROUND; side++) {
        double turn = side * EIGHTH_TURN, away = 2.0 * (double)radius;
        int64_t x = fits->origin[2 * n] + (int64_t)floor(away * cos(turn) + 0.5);
        int64_t y = fits->origin[2 * n + 1] + (int64_t)floor(away * sin(turn) + 0.5);
        bool clear = is_clear(picture, l, lights, x, y, radius, bright, room->dim + side);
        if (clear)
            read_patch(picture, x, y, p, rows, bytes);
        for (int i = 0; i < 2; i++)
            room->moved[side][i] = clear ? weigh(size, bytes, spread + i * size) : NAN;
    }
    scratch_release(mark);
}

/* Correct a spot by the shares (9,) of the amplitudes, and look around it. */
static void correct_spot(const Picture *picture, int64_t l, const double *lights, const Fits *fits,
                         int64_t n, const double *share, Room *room)
{
    Mark mark = scratch_mark();
    int64_t p = pixels_of(fits, n);
    double *weight = TAKE(double, 2 * p), reach[N_RIGHT][2], factors[N_PARAMETERS][2];
    average_correction(room, share, reach, factors);
    find_weights(room, p, rows_of(fits, n), factors, reach, weight);
    look_around(picture, l, lights, fits, n, weight, room);
    scratch_release(mark);
}

/* List the squares of what patches move over what is explained, and fill in their mean of each of m
 * spots; those that a dim light reaches only if wanted. Gives how many. */
static int64_t list_ratios(int64_t m, const Room *rooms, bool dim, double *ratio, double *mean)
{
    int64_t count = 0;
    for (int64_t n = 0; n < m; n++) {
        const Room *room = rooms + n;
        int64_t before = count;
        mean[n] = 0.0;
        for (int at = 0; at < 2 * N_AROUND; at++) {
            int side = at / 2, i = at % 2;
            double one = square(room->moved[side][i]) / room->explained[i];
            if (room->explained[i] > 0.0 && one >= 0.0 && (dim || !room->dim[side])) {
                ratio[count++] = one;
                mean[n] += one;
            }
        }
        mean[n] /= (double)MAX(count - before, 1);
    }
    return count;
}

/* Widen the covariances of m spots by what the room beside them moves beyond what is explained.
 *
 * Patches that a dim light reaches are texture where it leaves too few others: what is left beside
 * dim lights says it less well. */
static void add_excess(int64_t m, Room *rooms)
{
    Mark mark = scratch_mark();
    double *ratio = TAKE(double, 2 * N_AROUND * m), *mean = TAKE(double, m);
    int64_t count = list_ratios(m, rooms, false, ratio, mean);
    bool textured = count < MIN_AROUND;
    if (textured)
        count = list_ratios(m, rooms, true, ratio, mean);
    if (count >= MIN_AROUND) {
        double least = textured ? MIN_TEXTURE : 1.0, most = textured ? INFINITY : MAX_OWN;
        double usual = median(ratio, count) / MEDIAN_CHI2;
        usual = usual > least ? usual : 1.0;
        for (int64_t n = 0; n < m; n++) {
            double excess = (mean[n] > most * usual ? mean[n] : usual) - 1.0;
            for (int i = 0; i < 2; i++)
                rooms[n].own[i][1 + i] += excess * rooms[n].explained[i];
        }
    }
    scratch_release(mark);
}

void correct_for_room(const Picture *picture, int64_t l, const double *lights, const Fits *fits,
                      int64_t m, const int64_t *kept, const double *assessed, double *moments)
{
    Mark mark = scratch_mark();
    Room *rooms = TAKE(Room, m);
    double evidence[N_AMPLITUDES] = {0.0}, share[N_AMPLITUDES];
    memset(rooms, 0, sizeof(Room) * (size_t)m);
    for (int64_t k = 0; k < m; k++) {
        Room *room = rooms + k;
        int64_t n = kept[k], p = pixels_of(fits, n);
        if (assessed[N_COLUMNS * k + COL_MERGED] == 0.0)
            room->noise = surroundings_noise(p, rows_of(fits, n));
        if (room->noise > 0.0) {
            room->right = TAKE(float, N_RIGHT * p);
            fill_right(fits->parameters + N_PARAMETERS * n, p, rows_of(fits, n), room->right);
            if (!sum_curvature(fits, n, room, evidence))
                room->noise = 0.0;
        }
    }
    share_out(evidence, share);
    for (int64_t k = 0; k < m; k++)
        if (rooms[k].noise > 0.0)
            correct_spot(picture, l, lights, fits, kept[k], share, rooms + k);
    add_excess(m, rooms);
    for (int64_t k = 0; k < m; k++)
        for (int at = 0; at < 6; at++)
            moments[6 * k + at] += rooms[k].own[at / 3][at % 3];
    scratch_release(mark);
}
