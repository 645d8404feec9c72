/* Give each LED of a hypothesis the spot that it explains, and settle which hypotheses stay.
 *
 * With u an LED's predicted image, J its derivative by pose and shift, C their covariance, V that
 * of spot z, the spot costs
 *
 *     (z - u)' (V + J C J' + play^2)^-1 (z - u) + what it costs that z is merged with another
 *
 * beyond the gate it is none of the LED's. Two steps alternate until the spots are those that the
 * poses explain: Gauss-Newton steps on pose and shift with the spots held, and the choice of spots
 * with the pose held. Hypotheses that come to the same spots are one.
 *
 * Hypotheses are rows of `state` (h, 85), as `fit_all` has it, and of `spot` (h, 2, n), the spot
 * that each LED has in each image, -1 for none.
 */
#include "verify/core/kernels/linear_algebra.h"
#include "verify/core/kernels/scratch.h"
#include "verify/measurement/correspondence/kernels/fit.h"
#include "verify/measurement/correspondence/kernels/points.h"

#define MAX_GATE 10.0 /* px, an LED predicted worse than this could be any spot */
/* 2 ln of how much denser spots are at an LED (half a px) than clutter (20 an image) */
#define SPOT_REWARD 20.0
/* of the same kind: a clean spot is taken unless it lies 3 sigma farther off */
#define MERGED_COST 9.0
#define ALIKE_CHI2 9.0 /* by which a pose has to fit better than one that continues the motion */
/* 2 ln 30: an LED in one camera's view is hidden from the other once in 30 */
#define UNPAIRED_COST 7.0

/* What an assignment uses: spots, LEDs with a spot in an image, LEDs with one in both. */
typedef struct {
    int64_t used, leds, both;
} Counts;

/* Give every LED the cheapest of those spots (n, s) that no other LED gets cheaper. */
static void choose_spots(int64_t n_leds, int64_t n_spots, double *cost, int64_t *spot)
{
    for (int64_t k = 0; k < n_spots; k++) {
        double least = INFINITY;
        for (int64_t led = 0; led < n_leds; led++)
            least = MIN(least, cost[led * n_spots + k]);
        for (int64_t led = 0; led < n_leds; led++)
            if (cost[led * n_spots + k] > least)
                cost[led * n_spots + k] = INFINITY;
    }
    for (int64_t led = 0; led < n_leds; led++) {
        double least = INFINITY;
        spot[led] = -1;
        for (int64_t k = 0; k < n_spots; k++) {
            if (cost[led * n_spots + k] < least) {
                spot[led] = k;
                least = cost[led * n_spots + k];
            }
        }
    }
}

/* Fill in the variance xx, xy, yy, px^2, of an image whose derivative is `slope` (2, 8). */
static void image_variance(const double *slope, const double *covariance, double *variance)
{
    double x[N_FREE] = {0.0}, y[N_FREE] = {0.0};
    for (int j = 0; j < N_FREE; j++)
        for (int i = 0; i < N_FREE; i++) {
            x[i] += slope[j] * covariance[N_FREE * j + i];
            y[i] += slope[N_FREE + j] * covariance[N_FREE * j + i];
        }
    variance[0] = variance[1] = variance[2] = 0.0;
    for (int i = 0; i < N_FREE; i++) {
        variance[0] += x[i] * slope[i];
        variance[1] += x[i] * slope[N_FREE + i];
        variance[2] += y[i] * slope[N_FREE + i];
    }
}

/* Fill in what each spot of an image costs an LED (s,), infinity where it is none of the LED's. */
static void weigh_spots(const Scene *scene, Limits limits, int side, int64_t led,
                        const double *state, double largest, double *slope,
                        double *restrict cost)
{
    double image[2], variance[3];
    double depth = predict_image(scene, side, led, state, limits.nearest, image, slope);
    image_variance(slope, state + COVARIANCE, variance);
    bool placed = variance[0] + variance[2] <= 2.0 * largest * largest && depth > limits.nearest;
    double play2 = square(limits.play / MAX(depth, limits.nearest));
    double u = image[0] + side * state[SHIFT], v = image[1] + side * state[SHIFT + 1];
    double xx = variance[0] + play2, xy = variance[1], yy = variance[2] + play2;
    int64_t first = side * scene->n_spots;
    const double *restrict pixels = scene->pixels + 2 * first;
    const double *restrict noise = scene->covariance + 4 * first;
    const bool *restrict merged = scene->merged + first;
    const bool *restrict allowed = scene->allowed + (side * scene->n_leds + led) * scene->n_spots;
    for (int64_t k = 0; k < scene->n_spots; k++) {
        double x = pixels[2 * k] - u, y = pixels[2 * k + 1] - v;
        double a = noise[4 * k] + xx, b = noise[4 * k + 1] + xy, d = noise[4 * k + 3] + yy;
        double squared = (d * x * x - 2.0 * b * x * y + a * y * y) / (a * d - b * b);
        bool own = allowed[k] & placed & (squared <= MAX_DEVIATION * MAX_DEVIATION);
        cost[k] = own ? squared + MERGED_COST * merged[k] : INFINITY;
    }
}

/* Fill in the spot that each LED gets in each image; an LED whose place is known worse than
 * `largest`, px, gets none. Says whether any has changed. */
static bool gather_all(const Scene *scene, Limits limits, int64_t count, const double *state,
                       int64_t *spot, double largest)
{
    Mark mark = scratch_mark();
    int64_t n = scene->n_leds, *own = TAKE(int64_t, n);
    double *cost = TAKE(double, n * scene->n_spots), slope[2 * N_FREE] = {0.0};
    bool changed = false;
    for (int64_t h = 0; h < count; h++) {
        for (int side = 0; side < 2; side++, spot += n) {
            slope[6] = slope[N_FREE + 7] = side;
            for (int64_t led = 0; led < n; led++)
                weigh_spots(scene, limits, side, led, state + h * N_STATE, largest, slope,
                            cost + led * scene->n_spots);
            choose_spots(n, scene->n_spots, cost, own);
            for (int64_t led = 0; led < n; led++) {
                changed = changed || spot[led] != own[led];
                spot[led] = own[led];
            }
        }
    }
    scratch_release(mark);
    return changed;
}

static void copy_spots(int64_t n_leds, int64_t *target, const int64_t *source, int64_t count)
{
    memcpy(target, source, sizeof(int64_t) * (size_t)(count * 2 * n_leds));
}

/* Bring some hypotheses to the front, in their order. */
static void keep_rows(int64_t n_leds, double *state, int64_t *spot, int64_t count,
                      const int64_t *rows)
{
    Mark mark = scratch_mark();
    double *figures = TAKE(double, count * N_STATE);
    int64_t *assigned = TAKE(int64_t, count * 2 * n_leds);
    for (int64_t place = 0; place < count; place++) {
        copy(figures + place * N_STATE, state + rows[place] * N_STATE, N_STATE);
        copy_spots(n_leds, assigned + place * 2 * n_leds, spot + rows[place] * 2 * n_leds, 1);
    }
    copy(state, figures, count * N_STATE);
    copy_spots(n_leds, spot, assigned, count);
    scratch_release(mark);
}

/* Whether two hypotheses have the same spots. */
static bool same_spots(int64_t n_leds, const int64_t *spot, int64_t one, int64_t other)
{
    return !memcmp(spot + one * 2 * n_leds, spot + other * 2 * n_leds,
                   sizeof(int64_t) * (size_t)(2 * n_leds));
}

/* Bring the best fit of each assignment to the front: two poses of a flat marker may share one.
 * Gives how many there are, best first. */
static int64_t keep_unique(int64_t n_leds, int64_t count, double *state, int64_t *spot)
{
    if (count < 2)
        return count;
    Mark mark = scratch_mark();
    int64_t *order = TAKE(int64_t, count), kept = 0;
    for (int64_t h = 0; h < count; h++) {
        double chi2 = state[h * N_STATE + CHI2];
        int64_t place = h;
        for (; place > 0 && chi2 < state[order[place - 1] * N_STATE + CHI2]; place--)
            order[place] = order[place - 1];
        order[place] = h;
    }
    for (int64_t h = 0; h < count; h++) {
        bool new = true;
        for (int64_t k = 0; k < kept && new; k++)
            new = !same_spots(n_leds, spot, order[k], order[h]);
        if (new)
            order[kept++] = order[h];
    }
    keep_rows(n_leds, state, spot, kept, order);
    scratch_release(mark);
    return kept;
}

/* Bring to the front what follows a prediction, and other assignments; gives how many.
 *
 * `followed`, 0 or 1, of row 0, and `others`, of the rows behind it, count. An assignment has the
 * followed pose unless another one of it fits far better: a doubtful spot leaves a marker two. */
static int64_t keep_followed(int64_t n_leds, int64_t followed, int64_t others, double *state,
                             int64_t *spot)
{
    Mark mark = scratch_mark();
    int64_t *order = TAKE(int64_t, 1 + others), kept = 1;
    bool first = followed == 1;
    order[0] = 0;
    for (int64_t h = 1; h <= others; h++) {
        bool same = followed == 1 && same_spots(n_leds, spot, 0, h);
        bool better = state[h * N_STATE + CHI2] < state[CHI2] - ALIKE_CHI2;
        first = first && !(same && better);
        if (better || !same)
            order[kept++] = h;
    }
    kept -= !first;
    keep_rows(n_leds, state, spot, kept, first ? order : order + 1);
    scratch_release(mark);
    return kept;
}

static Counts count_spots(int64_t n_leds, const int64_t *spot)
{
    Counts counts = {0, 0, 0};
    for (int64_t led = 0; led < n_leds; led++) {
        bool left = spot[led] >= 0, right = spot[n_leds + led] >= 0;
        counts.used += left + right;
        counts.leds += left || right;
        counts.both += left && right;
    }
    return counts;
}

/* Bring those to the front that see an LED in both images and fit within their noise. `bounds`
 * (4 n + 1,): the greatest chi^2, by degrees of freedom. */
static int64_t keep_likely(int64_t n_leds, int64_t count, double *state, int64_t *spot,
                           const double *bounds)
{
    /* degrees of freedom, by LEDs seen: three determine all */
    static const int64_t DOF_BY_LEDS[] = {0, 3, 5, 6};
    Mark mark = scratch_mark();
    int64_t *likely = TAKE(int64_t, count), kept = 0;
    for (int64_t h = 0; h < count; h++) {
        Counts counts = count_spots(n_leds, spot + h * 2 * n_leds);
        int64_t freedom = 2 * counts.used - DOF_BY_LEDS[MIN(counts.leds, 3)];
        if (counts.both > 0 && state[h * N_STATE + CHI2] <= bounds[MAX(freedom, 1)])
            likely[kept++] = h;
    }
    if (kept < count)
        keep_rows(n_leds, state, spot, kept, likely);
    scratch_release(mark);
    return kept;
}

/* Gather and fit until the spots are those of the poses; keep each good assignment once. Gives how
 * many; they stand in front, best first. */
static int64_t settle(const Scene *scene, Limits limits, int64_t count, double *state,
                      int64_t *spot, const double *bounds)
{
    int64_t n = scene->n_leds;
    gather_all(scene, limits, count, state, spot, MAX_GATE);
    count = keep_unique(n, count, state, spot);
    fit_all(scene, limits, count, state, spot, 1);
    if (gather_all(scene, limits, count, state, spot, MAX_GATE))
        fit_all(scene, limits, count, state, spot, 2);
    return keep_unique(n, keep_likely(n, count, state, spot, bounds), state, spot);
}

/* Fit hypotheses in place, gather what each pose explains, fit again; see `settle`. */
static int64_t refine(const Scene *scene, Limits limits, int64_t count, double *state,
                      int64_t *spot, const double *bounds)
{
    fit_all(scene, limits, count, state, spot, 2); /* steps: from a few mm off they leave 0.01 px */
    return settle(scene, limits, count, state, spot, bounds);
}

/* Fill in the predicted pose, and what was found, begun anew (1 + others hypotheses). */
static void begin_following(int64_t n_leds, int64_t others, const double *found_state,
                            const int64_t *found_spot, const double *rig_T_flange,
                            const double *sigmas, double *state, int64_t *spot)
{
    begin_fit(state, sigmas);
    for (int i = 0; i < 3; i++) {
        copy(state + 3 * i, rig_T_flange + 4 * i, 3);
        state[POSITION + i] = rig_T_flange[4 * i + 3];
    }
    for (int64_t k = 0; k < 2 * n_leds; k++)
        spot[k] = -1;
    copy(state + N_STATE, found_state, others * N_STATE);
    copy_spots(n_leds, spot + 2 * n_leds, found_spot, others);
    for (int64_t h = 1; h <= others; h++)
        copy(state + h * N_STATE + HOLD, state + HOLD, CHI2 - HOLD);
}

/* Take the spots nearest to a predicted pose, row 0, alone and from what was found, `others` rows
 * behind it.
 *
 * LEDs that one camera alone sees are looked for anew. Gives how many `settle` keeps. */
static int64_t follow(const Scene *scene, Limits limits, int64_t others, double *state,
                      int64_t *spot, const double *bounds)
{
    int64_t n = scene->n_leds, *spots = spot + 2 * n;
    double *states = state + N_STATE;
    gather_all(scene, limits, 1, state, spot, INFINITY);
    /* one assignment, every LED with a spot and no spot left, that fits so well that no assignment
     * with an LED less would have more evidence */
    bool complete = others == 1 && count_spots(n, spots).used == 2 * n && scene->n_spots == n
        && states[CHI2] < SPOT_REWARD + UNPAIRED_COST;
    if (complete && same_spots(n, spot, 0, 1)) {
        fit_all(scene, limits, 2, state, spot, 2);
        int64_t count = keep_followed(n, 1, 1, state, spot);
        fit_all(scene, limits, count, state, spot, 1);
        return count;
    }
    fit_all(scene, limits, others, states, spots, 0);
    gather_all(scene, limits, others, states, spots, INFINITY);
    fit_all(scene, limits, 1 + others, state, spot, 2);
    int64_t followed = settle(scene, limits, 1, state, spot, bounds);
    others = settle(scene, limits, others, states, spots, bounds);
    return keep_followed(n, followed, others, state, spot);
}

/* Measure how far the LEDs of a hypothesis are from where a reference pose (4, 4) has them.
 *
 * `scales` (3,): position (m), rotation (rad), and how well a coarse pose places an LED (m).
 * `moves`: room for (n, 3). */
static double departure(int64_t n_leds, const double *leds, const int64_t *spot,
                        const double *state, const double *rig_T_flange, const double *scales,
                        double *moves)
{
    double mean[3] = {0.0}, middle[3] = {0.0}, radius = 0.0, turned = 0.0;
    int64_t seen = count_spots(n_leds, spot).leds;
    double share = 1.0 / MAX(seen, 1), along = scales[0], about = scales[1], coarse = scales[2];
    for (int64_t led = 0; led < n_leds; led++) {
        double weight = spot[led] >= 0 || spot[n_leds + led] >= 0 ? share : 0.0;
        for (int i = 0; i < 3; i++) {
            const double *row = rig_T_flange + 4 * i;
            double move = state[POSITION + i] - row[3];
            for (int j = 0; j < 3; j++)
                move += (state[3 * i + j] - row[j]) * leds[3 * led + j];
            moves[3 * led + i] = move;
            mean[i] += weight * move;
            middle[i] += weight * leds[3 * led + i];
        }
    }
    for (int64_t led = 0; led < n_leds; led++) {
        double weight = spot[led] >= 0 || spot[n_leds + led] >= 0 ? share : 0.0;
        for (int i = 0; i < 3; i++) {
            radius += weight * square(leds[3 * led + i] - middle[i]);
            turned += weight * square(moves[3 * led + i] - mean[i]);
        }
    }
    double lever = sqrt(dot(middle, middle)), moved = sqrt(dot(mean, mean));
    return hypot(moved / (along + about * lever + coarse),
                 sqrt(turned) / (about * sqrt(radius) + coarse));
}

static int64_t departures_of_all(int64_t n_leds, const double *leds, int64_t count,
                                 const int64_t *spot, const double *state,
                                 const double *rig_T_flange, const double *scales, double *off)
{
    Mark mark = scratch_mark();
    double *moves = TAKE(double, n_leds * 3);
    for (int64_t h = 0; h < count; h++)
        off[h] = departure(n_leds, leds, spot + h * 2 * n_leds, state + h * N_STATE, rig_T_flange,
                           scales, moves);
    scratch_release(mark);
    return 0;
}

int64_t entry_refine(
    const double *camera_R_rig, const double *center, const double *focal, int64_t n_spots,
    const double *pixels, const double *covariance, const bool *merged, const bool *allowed,
    int64_t n_leds, const double *leds, double nearest, double play, double shift_weight,
    int64_t count, double *state, int64_t *spot, const double *bounds)
{
    GUARDED(refine(SCENE, (Limits){nearest, play, shift_weight}, count, state, spot, bounds));
}

/* `found_state` (others, 85), `found_spot` (others, 2, n); filled: `state` (1 + others, 85) and
 * `spot` (1 + others, 2, n), of which as many count as it gives. */
int64_t entry_follow(
    const double *camera_R_rig, const double *center, const double *focal, int64_t n_spots,
    const double *pixels, const double *covariance, const bool *merged, const bool *allowed,
    int64_t n_leds, const double *leds, double nearest, double play, double shift_weight,
    int64_t others, const double *found_state, const int64_t *found_spot,
    const double *rig_T_flange, double position, double turn, double shift,
    const double *bounds, double *state, int64_t *spot)
{
    begin_following(n_leds, others, found_state, found_spot, rig_T_flange,
                    (double[]){position, turn, shift}, state, spot);
    GUARDED(follow(SCENE, (Limits){nearest, play, shift_weight}, others, state, spot, bounds));
}

/* Fill in `counts` (3, count): spots in use, LEDs with a spot in an image, LEDs with one in both */
int64_t entry_count_all(int64_t count, int64_t n_leds, const int64_t *spot, int64_t *counts)
{
    for (int64_t h = 0; h < count; h++) {
        Counts own = count_spots(n_leds, spot + h * 2 * n_leds);
        counts[h] = own.used;
        counts[count + h] = own.leds;
        counts[2 * count + h] = own.both;
    }
    return 0;
}

int64_t entry_departures_of_all(int64_t n_leds, const double *leds, int64_t count,
                                const int64_t *spot, const double *state,
                                const double *rig_T_flange, double along, double about,
                                double coarse, double *off)
{
    GUARDED(departures_of_all(n_leds, leds, count, spot, state, rig_T_flange,
                              (double[]){along, about, coarse}, off));
}
