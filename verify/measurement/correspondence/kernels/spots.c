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
 */
#include "verify/measurement/correspondence/kernels/spots.h"

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

/* Hypotheses, whose rows are `state` (h, 85), as `fit_all` has it, and `spot` (h, 2, n). */
typedef struct {
    int64_t n_leds;
    double *state;
    int64_t *spot;
} Rows;

/* What an assignment uses: spots, LEDs with a spot in an image, LEDs with one in both. */
typedef struct {
    int64_t used, leds, both;
} Counts;

static double *state_of(Rows of, int64_t h)
{
    return of.state + h * N_STATE;
}

static int64_t *spot_of(Rows of, int64_t h)
{
    return of.spot + h * 2 * of.n_leds;
}

static Rows from_row(Rows of, int64_t h)
{
    return (Rows){of.n_leds, state_of(of, h), spot_of(of, h)};
}

static void copy_rows(Rows target, Rows source, int64_t count)
{
    copy(target.state, source.state, count * N_STATE);
    memcpy(target.spot, source.spot, sizeof(int64_t) * (size_t)(count * 2 * target.n_leds));
}

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
    clear(variance, 3);
    for (int i = 0; i < N_FREE; i++) {
        variance[0] += x[i] * slope[i];
        variance[1] += x[i] * slope[N_FREE + i];
        variance[2] += y[i] * slope[N_FREE + i];
    }
}

/* Fill in what each spot of an image costs an LED (s,), infinity where it is none of the LED's. */
static void weigh_spots(const Scene *scene, int side, int64_t led, const double *state,
                        double largest, double *slope, double *restrict cost)
{
    double image[2], variance[3];
    double depth = predict_image(scene, side, led, state, image, slope);
    image_variance(slope, state + COVARIANCE, variance);
    bool placed = variance[0] + variance[2] <= 2.0 * largest * largest && depth > scene->nearest;
    double play2 = square(scene->play / MAX(depth, scene->nearest));
    double u = image[0] + side * state[SHIFT], v = image[1] + side * state[SHIFT + 1];
    double xx = variance[0] + play2, xy = variance[1], yy = variance[2] + play2;
    int64_t first = side * scene->n_spots;
    const double *restrict pixels = scene->pixels + 2 * first;
    const double *restrict noise = scene->covariance + 4 * first;
    const bool *restrict merged = scene->merged + first;
    const bool *restrict allowed = scene->allowed + (side * scene->n_leds + led) * scene->n_spots;
    for (int64_t k = 0; k < scene->n_spots; k++) {
        double squared = chi2_of(pixels[2 * k] - u, pixels[2 * k + 1] - v, noise[4 * k] + xx,
                                 noise[4 * k + 1] + xy, noise[4 * k + 3] + yy);
        bool own = allowed[k] & placed & (squared <= MAX_DEVIATION * MAX_DEVIATION);
        cost[k] = own ? squared + MERGED_COST * merged[k] : INFINITY;
    }
}

/* Fill in the spot that each LED gets in each image; an LED whose place is known worse than
 * `largest`, px, gets none. Says whether any has changed. */
static bool gather_all(const Scene *scene, int64_t count, Rows at, double largest)
{
    Mark mark = scratch_mark();
    int64_t n = at.n_leds, *own = TAKE(int64_t, n), *spot = at.spot;
    double *cost = TAKE(double, n * scene->n_spots), slope[2 * N_FREE] = {0.0};
    bool changed = false;
    for (int64_t h = 0; h < count; h++) {
        for (int side = 0; side < 2; side++, spot += n) {
            slope[6] = slope[N_FREE + 7] = side;
            for (int64_t led = 0; led < n; led++)
                weigh_spots(scene, side, led, state_of(at, h), largest, slope,
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

/* Bring some hypotheses to the front, in their order. */
static void keep_rows(Rows at, int64_t count, const int64_t *rows)
{
    Mark mark = scratch_mark();
    Rows kept = {at.n_leds, TAKE(double, count * N_STATE),
                 TAKE(int64_t, count * 2 * at.n_leds)};
    for (int64_t place = 0; place < count; place++)
        copy_rows(from_row(kept, place), from_row(at, rows[place]), 1);
    copy_rows(at, kept, count);
    scratch_release(mark);
}

/* Whether two hypotheses have the same spots. */
static bool same_spots(Rows at, int64_t one, int64_t other)
{
    size_t size = sizeof(int64_t) * (size_t)(2 * at.n_leds);
    return !memcmp(spot_of(at, one), spot_of(at, other), size);
}

/* Bring the best fit of each assignment to the front: two poses of a flat marker may share one.
 * Gives how many there are, best first. */
static int64_t keep_unique(Rows at, int64_t count)
{
    Mark mark = scratch_mark();
    int64_t *order = TAKE(int64_t, count), kept = 0;
    for (int64_t h = 0; h < count; h++) {
        double chi2 = state_of(at, h)[CHI2];
        int64_t place = h;
        for (; place > 0 && chi2 < state_of(at, order[place - 1])[CHI2]; place--)
            order[place] = order[place - 1];
        order[place] = h;
    }
    for (int64_t h = 0; h < count; h++) {
        bool new = true;
        for (int64_t k = 0; k < kept && new; k++)
            new = !same_spots(at, order[k], order[h]);
        if (new)
            order[kept++] = order[h];
    }
    keep_rows(at, kept, order);
    scratch_release(mark);
    return kept;
}

/* Bring to the front what follows a prediction, and other assignments; gives how many.
 *
 * `followed`, 0 or 1, of row 0, and `others`, of the rows behind it, count. An assignment has the
 * followed pose unless another one of it fits far better: a doubtful spot leaves a marker two. */
static int64_t keep_followed(Rows at, int64_t followed, int64_t others)
{
    Mark mark = scratch_mark();
    int64_t *order = TAKE(int64_t, 1 + others), kept = 1;
    bool first = followed == 1;
    order[0] = 0;
    for (int64_t h = 1; h <= others; h++) {
        bool same = followed == 1 && same_spots(at, 0, h);
        bool better = state_of(at, h)[CHI2] < at.state[CHI2] - ALIKE_CHI2;
        first = first && !(same && better);
        if (better || !same)
            order[kept++] = h;
    }
    kept -= !first;
    keep_rows(at, kept, first ? order : order + 1);
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
static int64_t keep_likely(Rows at, int64_t count, const double *bounds)
{
    /* degrees of freedom, by LEDs seen: three determine all */
    static const int64_t DOF_BY_LEDS[] = {0, 3, 5, 6};
    Mark mark = scratch_mark();
    int64_t *likely = TAKE(int64_t, count), kept = 0;
    for (int64_t h = 0; h < count; h++) {
        Counts counts = count_spots(at.n_leds, spot_of(at, h));
        int64_t freedom = 2 * counts.used - DOF_BY_LEDS[MIN(counts.leds, 3)];
        if (counts.both > 0 && state_of(at, h)[CHI2] <= bounds[MAX(freedom, 1)])
            likely[kept++] = h;
    }
    keep_rows(at, kept, likely);
    scratch_release(mark);
    return kept;
}

/* Gather and fit until the spots are those of the poses; keep each good assignment once. Gives how
 * many; they stand in front, best first. */
static int64_t settle(const Scene *scene, int64_t count, Rows at, const double *bounds)
{
    gather_all(scene, count, at, MAX_GATE);
    count = keep_unique(at, count);
    fit_all(scene, count, at.state, at.spot, 1);
    if (gather_all(scene, count, at, MAX_GATE))
        fit_all(scene, count, at.state, at.spot, 2);
    return keep_unique(at, keep_likely(at, count, bounds));
}

/* Fit hypotheses in place, gather what each pose explains, fit again; see `settle`. */
static int64_t refine(const Scene *scene, int64_t count, Rows at, const double *bounds)
{
    /* steps: from a few mm off they leave 0.01 px */
    fit_all(scene, count, at.state, at.spot, 2);
    return settle(scene, count, at, bounds);
}

/* Fill in the predicted pose, and what was found, begun anew (1 + others hypotheses). */
static void begin_following(int64_t others, Rows found, const double *rig_T_flange,
                            const double *sigmas, Rows at)
{
    begin_fit(at.state, sigmas);
    for (int i = 0; i < 3; i++) {
        copy(at.state + 3 * i, rig_T_flange + 4 * i, 3);
        at.state[POSITION + i] = rig_T_flange[4 * i + 3];
    }
    memset(at.spot, 255, sizeof(int64_t) * (size_t)(2 * at.n_leds)); /* -1 */
    copy_rows(from_row(at, 1), found, others);
    for (int64_t h = 1; h <= others; h++)
        copy(state_of(at, h) + HOLD, at.state + HOLD, CHI2 - HOLD);
}

/* Take the spots nearest to a predicted pose, row 0, alone and from what was found, `others` rows
 * behind it.
 *
 * LEDs that one camera alone sees are looked for anew. Gives how many `settle` keeps. */
static int64_t follow(const Scene *scene, int64_t others, Rows at, const double *bounds)
{
    int64_t n = at.n_leds;
    Rows rest = from_row(at, 1);
    gather_all(scene, 1, at, INFINITY);
    /* one assignment, every LED with a spot and no spot left, that fits so well that no assignment
     * with an LED less would have more evidence */
    bool complete = others == 1 && count_spots(n, rest.spot).used == 2 * n && scene->n_spots == n
        && rest.state[CHI2] < SPOT_REWARD + UNPAIRED_COST;
    if (complete && same_spots(at, 0, 1)) {
        fit_all(scene, 2, at.state, at.spot, 2);
        int64_t count = keep_followed(at, 1, 1);
        fit_all(scene, count, at.state, at.spot, 1);
        return count;
    }
    fit_all(scene, others, rest.state, rest.spot, 0);
    gather_all(scene, others, rest, INFINITY);
    fit_all(scene, 1 + others, at.state, at.spot, 2);
    int64_t followed = settle(scene, 1, at, bounds);
    return keep_followed(at, followed, settle(scene, others, rest, bounds));
}

int64_t follow_alone(const Scene *scene, const double *rig_T_flange, const double *sigmas,
                     const double *bounds, double *state, int64_t *spot)
{
    Rows at = {scene->n_leds, state, spot};
    begin_following(0, at, rig_T_flange, sigmas, at);
    return follow(scene, 0, at, bounds);
}

/* Measure how far the LEDs of a hypothesis are from where a reference pose (4, 4) has them: by how
 * much their middle moves, and how they turn about it.
 *
 * `scales` (3,): position (m), rotation (rad), and how well a coarse pose places an LED (m). */
static double departure(int64_t n_leds, const double *leds, const int64_t *spot,
                        const double *state, const double *reference, const double *scales)
{
    double middle[3] = {0.0}, radius = 0.0, turned = 0.0, mean[3], turn[9];
    int64_t seen = count_spots(n_leds, spot).leds;
    double share = 1.0 / MAX(seen, 1), along = scales[0], about = scales[1], coarse = scales[2];
    for (int64_t k = 0; k < 3 * n_leds; k++)
        if (spot[k / 3] >= 0 || spot[n_leds + k / 3] >= 0)
            middle[k % 3] += share * leds[k];
    for (int i = 0; i < 3; i++) {
        for (int j = 0; j < 3; j++)
            turn[3 * i + j] = state[3 * i + j] - reference[4 * i + j];
        mean[i] = state[POSITION + i] - reference[4 * i + 3] + dot(turn + 3 * i, middle);
    }
    for (int64_t led = 0; led < n_leds; led++) {
        double arm[3];
        for (int i = 0; i < 3; i++)
            arm[i] = leds[3 * led + i] - middle[i];
        if (spot[led] < 0 && spot[n_leds + led] < 0)
            continue;
        radius += share * dot(arm, arm);
        for (int i = 0; i < 3; i++)
            turned += share * square(dot(turn + 3 * i, arm));
    }
    double lever = sqrt(dot(middle, middle)), moved = sqrt(dot(mean, mean));
    return hypot(moved / (along + about * lever + coarse),
                 sqrt(turned) / (about * sqrt(radius) + coarse));
}

int64_t entry_refine(
    const double *camera_R_rig, const double *center, const double *focal, int64_t n_spots,
    const double *pixels, const double *covariance, const bool *merged, const bool *allowed,
    int64_t n_leds, const double *leds, double nearest, double play, double shift_weight,
    int64_t count, double *state, int64_t *spot, const double *bounds)
{
    Rows at = {n_leds, state, spot};
    GUARDED(refine(SCENE(nearest, play, shift_weight), count, at, bounds));
}

/* `found_state` (others, 85), `found_spot` (others, 2, n); filled: `state` (1 + others, 85) and
 * `spot` (1 + others, 2, n), of which as many count as it gives. */
int64_t entry_follow(
    const double *camera_R_rig, const double *center, const double *focal, int64_t n_spots,
    const double *pixels, const double *covariance, const bool *merged, const bool *allowed,
    int64_t n_leds, const double *leds, double nearest, double play, double shift_weight,
    int64_t others, double *found_state, int64_t *found_spot, const double *rig_T_flange,
    double position, double turn, double shift, const double *bounds, double *state, int64_t *spot)
{
    Rows at = {n_leds, state, spot}, found = {n_leds, found_state, found_spot};
    begin_following(others, found, rig_T_flange, (double[]){position, turn, shift}, at);
    GUARDED(follow(SCENE(nearest, play, shift_weight), others, at, bounds));
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
    for (int64_t h = 0; h < count; h++)
        off[h] = departure(n_leds, leds, spot + h * 2 * n_leds, state + h * N_STATE, rig_T_flange,
                           (double[]){along, about, coarse});
    return 0;
}
