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
#define N_WIDE 12 /* amplitudes side by side, that the processor takes at once */
#define N_AROUND 8      /* patches of the room about each spot, two radii away */
#define MIN_AROUND 12   /* responses, two a patch, of all spots of a picture: fewer show nothing */
#define MIN_TEXTURE 6.0 /* of that median over what is explained, where patches have dim lights */
#define MAX_DIM 0.5     /* of a spot's peak: a light that is less may be texture of the room */
#define MAX_OWN 3.0     /* of the picture's: a spot's own surroundings move it more than chance */
#define CHUNK 64  /* pixels, whose weights the fastest memory holds */
#define VECTOR 32 /* bytes */
#define EIGHT 8   /* bytes that are read at once; no more than the least radius of a patch */
#define MEDIAN_CHI2 0.4549 /* of chi^2 with one degree of freedom */
#define HALF_ROOT 0.7071067811865476

/* DN, beside none at all; those behind the ninth only fill vectors */
static const double AMPLITUDES[N_WIDE] = {0.1, 0.2, 0.4, 0.8, 1.6, 3.2,
                                          6.4, 12.8, 25.6, 1.0, 1.0, 1.0};
static const double DIRECTIONS[N_AROUND][2] = {
    {1.0, 0.0}, {HALF_ROOT, HALF_ROOT}, {0.0, 1.0}, {-HALF_ROOT, HALF_ROOT},
    {-1.0, 0.0}, {-HALF_ROOT, -HALF_ROOT}, {0.0, -1.0}, {HALF_ROOT, -HALF_ROOT},
};

/* What a spot shows of the room behind it. */
typedef struct {
    double noise; /* DN^2, of its pixels that show the room alone; 0 of a spot left alone */
    float *right; /* (8, p), its residuals, and the derivatives by the curvature's terms */
    /* how the parameters follow r and B, and the columns of x and y of A^-1 */
    double follow[N_PARAMETERS][N_RIGHT + 2];
    /* (S + s^-2)^-1 times h and the pull, at each amplitude */
    double solved[N_TERMS][3][N_WIDE];
    double own[2][3];          /* shift, px, and covariance, px^2 */
    double moved[N_AROUND][2]; /* px, by patches beside it; NaN where there is none */
    bool dim[N_AROUND];        /* which of them a dim light reaches */
    double explained[2];       /* px^2, of their squares */
} Room;

/* A number of pixels, filled up to whole vectors of bytes. */
static int64_t whole_vectors(int64_t p)
{
    return (p + VECTOR - 1) / VECTOR * VECTOR;
}

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

/* Fill in the factors of S + s^-2 (7, 7) for all amplitudes at once, with the inverse of their
 * diagonals, and the root of |1 + s^2 S|, `volume`; no number, or 0, where rounding leaves no S.
 *
 * `left` (8, 8), r and B with themselves, the spot's parameters following: h and S are in it. */
static void factor_amplitudes(double (*left)[N_RIGHT], double (*root)[N_TERMS][N_WIDE],
                              double *volume)
{
    for (int k = 0; k < N_WIDE; k++)
        volume[k] = 1.0;
    for (int i = 0; i < N_TERMS; i++) {
        for (int j = 0; j <= i; j++) {
            double rest[N_WIDE];
            for (int k = 0; k < N_WIDE; k++)
                rest[k] = left[i + 1][j + 1] + (i == j ? 1.0 / square(AMPLITUDES[k]) : 0.0);
            for (int c = 0; c < j; c++)
                for (int k = 0; k < N_WIDE; k++)
                    rest[k] -= root[i][c][k] * root[j][c][k];
            for (int k = 0; k < N_WIDE && i > j; k++)
                root[i][j][k] = rest[k] * root[j][j][k];
            for (int k = 0; k < N_WIDE && i == j; k++) {
                double diagonal = sqrt(rest[k]);
                volume[k] *= AMPLITUDES[k] * diagonal;
                root[i][i][k] = 1.0 / diagonal;
            }
        }
    }
}

/* Fill in what a spot's curvature is at each amplitude, and add to their evidence (9,).
 *
 * `left` (8, 8) as for `factor_amplitudes`. False, and nothing added, where rounding leaves no S:
 * of a spot far over the limit, which hardly determines its own parameters. */
static bool solve_amplitudes(double (*left)[N_RIGHT], Room *room, double *evidence)
{
    double root[N_TERMS][N_TERMS][N_WIDE], volume[N_WIDE], (*solved)[3][N_WIDE] = room->solved;
    factor_amplitudes(left, root, volume);
    for (int k = 0; k < N_AMPLITUDES; k++)
        if (!(volume[k] > 0.0))
            return false;
    for (int i = 0; i < N_TERMS; i++) {
        double known[3] = {left[i + 1][0], -room->follow[PAR_X][i + 1],
                           -room->follow[PAR_Y][i + 1]};
        for (int r = 0; r < 3; r++) {
            for (int k = 0; k < N_WIDE; k++)
                solved[i][r][k] = known[r];
            for (int c = 0; c < i; c++)
                for (int k = 0; k < N_WIDE; k++)
                    solved[i][r][k] -= root[i][c][k] * solved[c][r][k];
            for (int k = 0; k < N_WIDE; k++)
                solved[i][r][k] *= root[i][i][k];
        }
    }
    for (int i = N_TERMS - 1; i >= 0; i--) {
        for (int r = 0; r < 3; r++) {
            for (int c = i + 1; c < N_TERMS; c++)
                for (int k = 0; k < N_WIDE; k++)
                    solved[i][r][k] -= root[c][i][k] * solved[c][r][k];
            for (int k = 0; k < N_WIDE; k++)
                solved[i][r][k] *= root[i][i][k];
        }
    }
    for (int k = 0; k < N_AMPLITUDES; k++) {
        for (int c = 0; c < N_TERMS; c++)
            evidence[k] += 0.5 * solved[c][0][k] * left[c + 1][0];
        evidence[k] -= log(volume[k]);
    }
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
    double (*follow)[N_RIGHT + 2] = room->follow, (*own)[3] = room->own;
    memset(reach, 0, sizeof(double) * N_RIGHT * 2);
    for (int k = 0; k < N_AMPLITUDES; k++) {
        double moved[2] = {0.0, 0.0};
        for (int i = 0; i < 2; i++) {
            for (int c = 0; c < N_TERMS; c++) {
                moved[i] -= room->solved[c][0][k] * follow[i][c + 1];
                reach[c + 1][i] += share[k] * room->solved[c][1 + i][k];
            }
            own[i][0] += share[k] * moved[i];
        }
        for (int i = 0; i < 2; i++)
            for (int j = 0; j < 2; j++)
                own[i][1 + j] += share[k] * moved[i] * moved[j];
    }
    for (int i = 0; i < 2; i++) {
        for (int j = 0; j < 2; j++) {
            own[i][1 + j] -= own[i][0] * own[j][0];
            for (int c = 1; c < N_RIGHT; c++)
                own[i][1 + j] -= follow[j][c] * reach[c][i];
        }
        for (int a = 0; a < N_PARAMETERS; a++) {
            factors[a][i] = 0.0;
            for (int c = 1; c < N_RIGHT; c++)
                factors[a][i] -= follow[a][c] * reach[c][i];
        }
    }
}

/* Add m rows of n pixels, p apart, each times its two factors (m, 2), to both of `total`
 * (2, CHUNK); m is even.
 *
 * In double precision: of a spot far over the limit they nearly cancel. */
static void add_rows(int m, double (*factors)[2], int64_t p, int64_t n, const float *rows,
                     double *restrict total)
{
    for (int a = 0; a < m; a += 2) {
        const double *one = factors[a], *other = factors[a + 1];
        const float *first = rows + a * p, *second = first + p;
#pragma omp simd
        for (int64_t k = 0; k < n; k++) {
            double x = (double)first[k], y = (double)second[k];
            total[k] = total[k] + one[0] * x + other[0] * y;
            total[CHUNK + k] = total[CHUNK + k] + one[1] * x + other[1] * y;
        }
    }
}

/* Add two weights of n pixels (n,) up, both over the pixels' sigmas, and make them those of DN,
 * `weight` (n,). To `sums` (2,) are added the squares of `plain` and the whole ones. */
static void weigh_rows(int64_t p, int64_t n, const float *rows, const double *restrict plain,
                       const double *restrict added, double *restrict weight, double *sums)
{
    const float *used = rows + ROW_USED * p, *variance = rows + ROW_VARIANCE * p;
    double squares = 0.0, total = 0.0;
#pragma omp simd reduction(+ : squares, total)
    for (int64_t k = 0; k < n; k++) {
        double scale = (double)sqrtf(used[k] / variance[k]), one = plain[k] * scale;
        squares += one * one;
        one += added[k] * scale;
        weight[k] = one;
        total += one;
    }
    sums[0] += squares;
    sums[1] += total;
}

/* Fill in by how much each pixel moves the centre, px/DN, `weight` (2, q) of p; `explained` (2,):
 * the sums of squares without the correction.
 *
 * `factors` (10, 2) and `reach` (8, 2) as by `average_correction`. Less their mean, as the level of
 * the room moves nothing. */
static void find_weights(const Room *room, int64_t p, const float *rows, double (*factors)[2],
                         double (*reach)[2], int64_t q, double *weight, double *explained)
{
    double direct[N_PARAMETERS][2], sums[2][2] = {{0.0}};
    for (int a = 0; a < N_PARAMETERS; a++)
        copy(direct[a], room->follow[a] + N_RIGHT, 2);
    for (int64_t begin = 0; begin < p; begin += CHUNK) {
        double plain[2 * CHUNK] = {0.0}, added[2 * CHUNK] = {0.0};
        int64_t n = MIN(p - begin, CHUNK);
        add_rows(N_PARAMETERS, direct, p, n, rows + begin, plain);
        add_rows(N_PARAMETERS, factors, p, n, rows + begin, added);
        add_rows(N_RIGHT, reach, p, n, room->right + begin, added);
        for (int i = 0; i < 2; i++)
            weigh_rows(p, n, rows + begin, plain + i * CHUNK, added + i * CHUNK,
                       weight + i * q + begin, sums[i]);
    }
    for (int i = 0; i < 2; i++) {
        explained[i] = sums[i][0];
        for (int64_t k = 0; k < p; k++)
            weight[i * q + k] -= sums[i][1] / (double)p;
    }
}

/* How to read the bytes of a patch, eight at a time, its last row first and each from its end: what
 * is read too much, left of a row, the row before it overwrites. */
typedef struct {
    int64_t n;       /* eights */
    int64_t *place;  /* (n,), where they are in the picture, from the centre's bytes */
    int64_t *target; /* (n,), where they belong in `bytes` */
    uint8_t *bytes;  /* room for the patch's, with EIGHT before and zeros behind them */
} Layout;

/* Say how to read p pixels of a picture, `rows` (25, p): a disc, row by row. Taken from scratch. */
static Layout lay_out(const Picture *picture, int64_t p, const float *rows)
{
    const float *column = rows + ROW_COLUMN * p, *row = rows + ROW_ROW * p;
    int64_t depth = picture->channels, size = depth * whole_vectors(p), most = depth * p;
    Layout layout = {0, TAKE(int64_t, most), TAKE(int64_t, most), TAKE(uint8_t, EIGHT + size)};
    layout.bytes += EIGHT;
    memset(layout.bytes + depth * p, 0, (size_t)(size - depth * p));
    for (int64_t end = p, begin; end > 0; end = begin) {
        int64_t half = (int64_t)column[end - 1], line = (int64_t)row[end - 1];
        int64_t place = depth * (picture->width * line + half + 1);
        begin = end - 2 * half - 1;
        for (int64_t at = depth * end; at > depth * begin; at -= EIGHT) {
            place -= EIGHT;
            layout.place[layout.n] = place;
            layout.target[layout.n++] = at - EIGHT;
        }
    }
    return layout;
}

/* Fill in the sums, DN, of n bytes with each of two weights (2, n); `values`, from the centre's
 * bytes on. */
static void weigh_room(const uint8_t *values, const Layout *layout, int64_t n,
                       const double *restrict weight, double *moved)
{
    double first = 0.0, second = 0.0;
    uint8_t *restrict bytes = layout->bytes;
    for (int64_t k = 0; k < layout->n; k++)
        memcpy(bytes + layout->target[k], values + layout->place[k], EIGHT);
#pragma omp simd reduction(+ : first, second)
    for (int64_t k = 0; k < n; k++) {
        double value = (double)bytes[k];
        first += value * weight[k];
        second += value * weight[n + k];
    }
    moved[0] = first;
    moved[1] = second;
}

/* Share the weights (2, n) of n pixels out to their B, G and R, (2, 3 n), as the spot's colour (3,)
 * does; taken from scratch. */
static double *spread_weights(const double *colour, int64_t n, const double *weight)
{
    double *spread = TAKE(double, 6 * n), channels[3];
    channel_weights(colour, channels);
    for (int64_t k = 0; k < 2 * n; k++)
        for (int c = 0; c < 3; c++)
            spread[3 * k + c] = channels[c] * weight[k];
    return spread;
}

/* Whether a patch about a pixel (x, y) is inside the picture, and reached by no light but such as
 * are dim beside the spot; `dim`, filled: whether by one of those.
 *
 * `lights` (l, 4): place and half width, px, and contrast, DN, of all; `bright`, DN. */
static bool is_clear(const Picture *picture, int64_t l, const double *lights, int64_t x, int64_t y,
                     int64_t radius, double bright, bool *dim)
{
    *dim = false;
    /* the topmost row of a patch has one pixel, with which some left of it are read */
    if (x < MAX(radius, EIGHT) || x >= picture->width - radius || y < radius ||
        y >= picture->height - radius)
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
 * `lights` (l, 4) as for `is_clear`; `weight` (2, whole_vectors(p)), of the pixels. */
static void look_around(const Picture *picture, int64_t l, const double *lights, const Fits *fits,
                        int64_t n, const double *weight, Room *room)
{
    Mark mark = scratch_mark();
    const float *rows = rows_of(fits, n);
    int64_t p = pixels_of(fits, n), size = whole_vectors(p);
    int64_t radius = -(int64_t)rows[ROW_ROW * p]; /* the topmost pixel comes first */
    double peak = fits->parameters[N_PARAMETERS * n + PAR_PEAK];
    double bright = MAX_DIM * MIN(peak, (double)SENSOR_LIMIT);
    Layout layout = lay_out(picture, p, rows);
    if (picture->channels > 1) {
        weight = spread_weights(fits->colour + 3 * n, size, weight);
        size *= 3;
    }
    for (int side = 0; side < N_AROUND; side++) {
        const double *turn = DIRECTIONS[side];
        int64_t x = fits->origin[2 * n] + (int64_t)floor(2.0 * (double)radius * turn[0] + 0.5);
        int64_t y = fits->origin[2 * n + 1] + (int64_t)floor(2.0 * (double)radius * turn[1] + 0.5);
        room->moved[side][0] = room->moved[side][1] = NAN;
        if (is_clear(picture, l, lights, x, y, radius, bright, room->dim + side))
            weigh_room(picture->values + picture->channels * (picture->width * y + x), &layout,
                       size, weight, room->moved[side]);
    }
    scratch_release(mark);
}

/* Widen the covariances of m spots by what the room beside them moves beyond what is explained.
 *
 * Patches that a dim light reaches are texture where it leaves too few others. */
static void add_excess(int64_t m, Room *rooms)
{
    Mark mark = scratch_mark();
    double *ratio = TAKE(double, 2 * N_AROUND * m), *mean = TAKE(double, m);
    double least = 1.0, most = MAX_OWN;
    int64_t pooled = 0;
    for (int textured = 0; textured < 2 && pooled < MIN_AROUND; textured++) {
        if (textured) { /* what is left beside dim lights says it less well */
            least = MIN_TEXTURE;
            most = INFINITY;
        }
        pooled = 0;
        for (int64_t n = 0; n < m; n++) {
            const Room *room = rooms + n;
            int64_t before = pooled;
            mean[n] = 0.0;
            for (int at = 0; at < 2 * N_AROUND; at++) {
                int side = at / 2, i = at % 2;
                double one = square(room->moved[side][i]) / room->explained[i];
                if (room->explained[i] > 0.0 && one >= 0.0 && (textured || !room->dim[side])) {
                    ratio[pooled++] = one;
                    mean[n] += one;
                }
            }
            mean[n] /= (double)MAX(pooled - before, 1);
        }
    }
    if (pooled >= MIN_AROUND) {
        double usual = median(ratio, pooled) / MEDIAN_CHI2;
        usual = usual > least ? usual : 1.0;
        for (int64_t n = 0; n < m; n++) {
            double excess = (mean[n] > most * usual ? mean[n] : usual) - 1.0;
            for (int i = 0; i < 2; i++)
                rooms[n].own[i][1 + i] += excess * rooms[n].explained[i];
        }
    }
    scratch_release(mark);
}

/* Correct a spot by the shares (9,) of the amplitudes, and look around it. */
static void correct_spot(const Picture *picture, int64_t l, const double *lights, const Fits *fits,
                         int64_t n, const double *share, Room *room)
{
    Mark mark = scratch_mark();
    int64_t p = pixels_of(fits, n), q = whole_vectors(p);
    double *weight = TAKE(double, 2 * q), reach[N_RIGHT][2], factors[N_PARAMETERS][2];
    for (int i = 0; i < 2; i++)
        memset(weight + i * q + p, 0, sizeof(double) * (size_t)(q - p));
    average_correction(room, share, reach, factors);
    find_weights(room, p, rows_of(fits, n), factors, reach, q, weight, room->explained);
    for (int i = 0; i < 2; i++)
        room->explained[i] = room->explained[i] * room->noise + room->own[i][1 + i];
    look_around(picture, l, lights, fits, n, weight, room);
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
