/* Sets of points that fit the marker's distances, and the poses that a search begins at.
 *
 * Nodes ("this point is that LED") a and b agree if their points are as far apart as their LEDs:
 *
 *     ||pa - pb| - |la - lb|| <= MAX_DEVIATION * sqrt(e' (Va + Vb) e + 2 play^2),  e along pa - pb
 *
 * Three nodes, every two of which agree, give a pose. A marker of many LEDs has thousands of pairs
 * and triples of nodes.
 */
#include "verify/core/kernels/linear_algebra.h"
#include "verify/core/kernels/scratch.h"
#include "verify/measurement/correspondence/kernels/fit.h"
#include "verify/measurement/correspondence/kernels/points.h"

/* height over longest side; of a more slender one, gathering about a line finds the third LED */
#define MIN_HEIGHT_RATIO 0.01

/* c points: spots (c, 2), places (c, 3), m, and their covariance (c, 3, 3), m^2. */
typedef struct {
    int64_t count;
    const int64_t *spot;
    const double *rig, *covariance;
} Points;

/* m nodes: point and LED of each, (m,) both. */
typedef struct {
    const int64_t *point, *led;
} Nodes;

/* Variance along a direction (3,), of a covariance (3, 3). */
static double variance_along(const double *covariance, const double *e)
{
    double own = covariance[0] * e[0] * e[0] + covariance[4] * e[1] * e[1]
        + covariance[8] * e[2] * e[2];
    double shared = covariance[1] * e[0] * e[1] + covariance[2] * e[0] * e[2]
        + covariance[5] * e[1] * e[2];
    return own + 2.0 * shared;
}

/* Fill in how far every two points are apart, m, infinitely where they share a spot, and the
 * standard deviation of that, (c, c) both. */
static void measure_distances(const Points *points, double play, double *apart, double *sigma)
{
    int64_t count = points->count;
    for (int64_t i = 0; i < count; i++) {
        for (int64_t j = 0; j <= i; j++) {
            const double *a = points->rig + 3 * i, *b = points->rig + 3 * j;
            const int64_t *one = points->spot + 2 * i, *other = points->spot + 2 * j;
            double far = INFINITY, deviation = 1.0;
            if (one[0] != other[0] && one[1] != other[1]) {
                far = distance(a, b);
                double over = far > 0.0 ? 1.0 / far : 1.0;
                double e[3] = {(a[0] - b[0]) * over, (a[1] - b[1]) * over, (a[2] - b[2]) * over};
                double spread = variance_along(points->covariance + 9 * i, e)
                    + variance_along(points->covariance + 9 * j, e);
                deviation = sqrt(spread + 2.0 * play * play);
            }
            apart[i * count + j] = apart[j * count + i] = far;
            sigma[i * count + j] = sigma[j * count + i] = deviation;
        }
    }
}

/* List the nodes, and how far every two are from the marker's distance, in deviations; gives how
 * many.
 *
 * `play`, m: how far an LED's light may be from where the marker has it. Filled: point and LED of
 * each node, (m,) both, and `deviation` (m, m), the upper half; infinitely far are nodes that share
 * a spot or an LED. */
static int64_t join_nodes(const Scene *scene, const Points *points, double play, int64_t *point,
                          int64_t *led, double *deviation)
{
    Mark mark = scratch_mark();
    int64_t count = points->count, n = scene->n_leds, nodes = 0;
    const bool *left = scene->allowed, *right = left + n * scene->n_spots;
    for (int64_t one = 0; one < n; one++) {
        for (int64_t i = 0; i < count; i++) {
            const int64_t *spot = points->spot + 2 * i;
            if (left[one * scene->n_spots + spot[0]] && right[one * scene->n_spots + spot[1]]) {
                point[nodes] = i;
                led[nodes++] = one;
            }
        }
    }
    double *apart = TAKE(double, count * count), *sigma = TAKE(double, count * count);
    double *wanted = TAKE(double, n * n);
    measure_distances(points, play, apart, sigma);
    for (int64_t a = 0; a < n; a++)
        for (int64_t b = 0; b < n; b++)
            wanted[a * n + b] = distance(scene->leds + 3 * a, scene->leds + 3 * b);
    for (int64_t a = 0; a < nodes; a++) {
        const double *far = apart + point[a] * count, *noise = sigma + point[a] * count;
        for (int64_t b = 0; b < nodes; b++) {
            double off = fabs(far[point[b]] - wanted[led[a] * n + led[b]]) / noise[point[b]];
            deviation[a * nodes + b] = a < b && led[a] != led[b] ? off : INFINITY;
        }
    }
    scratch_release(mark);
    return nodes;
}

/* Whether a triangle (3,) of LEDs is too slender to give a pose. */
static bool is_slender(const double *leds, const int64_t *corner)
{
    double side[3], other[3], across[3];
    for (int i = 0; i < 3; i++) {
        side[i] = leds[3 * corner[1] + i] - leds[3 * corner[0] + i];
        other[i] = leds[3 * corner[2] + i] - leds[3 * corner[0] + i];
    }
    cross(side, other, across);
    double longest = MAX(dot(side, side), dot(other, other));
    return !(sqrt(dot(across, across)) > MIN_HEIGHT_RATIO * longest);
}

/* List triples of nodes (t, 3) every two of which agree, best first; no slender triangles; gives t.
 *
 * `deviation` (m, m), of `join_nodes`; `edges` (e, 2), best first; `led` (m,), of each node; `leds`
 * (n, 3), m, flange frame. At most `most` are listed, by the sum of squares of the three
 * deviations. */
static int64_t list_triangles(int64_t nodes, const double *deviation, int64_t n_edges,
                              const int64_t *edges, const int64_t *led, const double *leds,
                              int64_t most, int64_t *triples)
{
    Mark mark = scratch_mark();
    int64_t count = 0;
    double *costs = TAKE(double, most);
    for (int64_t e = 0; e < n_edges; e++) {
        int64_t a = edges[2 * e], b = edges[2 * e + 1];
        const double *of_a = deviation + a * nodes, *of_b = deviation + b * nodes;
        for (int64_t c = b + 1; c < nodes; c++) {
            if (!(of_a[c] <= MAX_DEVIATION && of_b[c] <= MAX_DEVIATION)
                || is_slender(leds, (int64_t[]){led[a], led[b], led[c]}))
                continue;
            double cost = square(of_a[c]) + square(of_a[b]) + square(of_b[c]);
            count = insert_cost(cost, (int64_t[]){a, b, c}, 3, most, costs, triples, count);
        }
    }
    scratch_release(mark);
    return count;
}

/* Fill in a triangle's axes, rows of (3, 3): along its first side, in its plane, across it. */
static void triangle_axes(const double *a, const double *b, const double *c, double *axes)
{
    for (int i = 0; i < 3; i++) {
        axes[i] = b[i] - a[i];
        axes[3 + i] = c[i] - a[i];
    }
    cross(axes, axes + 3, axes + 6);
    scale_to_one(axes);
    scale_to_one(axes + 6);
    cross(axes + 6, axes, axes + 3);
}

/* Begin a hypothesis at a set of nodes: `state` (85,), as `fit_all` has it, and spots (2, n), -1
 * for none. `corners`: one, two or three nodes; `rotation` (3, 3), of no use where there are
 * three. */
static void begin_pose(const Points *points, Nodes graph, int corners, const int64_t *nodes,
                       int64_t n_leds, const double *leds, const double *rotation,
                       const double *sigmas, double *state, int64_t *spot)
{
    const double *where[3], *which[3];
    double rig_axes[9], led_axes[9];
    begin_fit(state, sigmas);
    for (int64_t k = 0; k < 2 * n_leds; k++)
        spot[k] = -1;
    for (int k = 0; k < corners; k++) {
        int64_t point = graph.point[nodes[k]], led = graph.led[nodes[k]];
        where[k] = points->rig + 3 * point;
        which[k] = leds + 3 * led;
        spot[led] = points->spot[2 * point];
        spot[n_leds + led] = points->spot[2 * point + 1];
    }
    if (corners == 3) {
        triangle_axes(where[0], where[1], where[2], rig_axes);
        triangle_axes(which[0], which[1], which[2], led_axes);
        for (int i = 0; i < 3; i++)
            for (int j = 0; j < 3; j++)
                state[3 * i + j] = rig_axes[i] * led_axes[j] + rig_axes[3 + i] * led_axes[3 + j]
                    + rig_axes[6 + i] * led_axes[6 + j];
    } else {
        copy(state, rotation, 9);
    }
    for (int i = 0; i < 3; i++) {
        state[POSITION + i] = 0.0;
        for (int k = 0; k < corners; k++)
            state[POSITION + i] += (where[k][i] - dot(state + 3 * i, which[k])) / corners;
    }
}

int64_t entry_join_nodes(
    const double *camera_R_rig, const double *center, const double *focal, int64_t n_spots,
    const double *pixels, const double *covariance, const bool *merged, const bool *allowed,
    int64_t n_leds, const double *leds, int64_t count, const int64_t *spot, const double *rig,
    const double *spread, double play, int64_t *point, int64_t *led, double *deviation)
{
    Points points = {count, spot, rig, spread};
    GUARDED(join_nodes(SCENE(0.0, 0.0, 0.0), &points, play, point, led, deviation));
}

int64_t entry_list_triangles(int64_t nodes, const double *deviation, int64_t n_edges,
                             const int64_t *edges, const int64_t *led, const double *leds,
                             int64_t most, int64_t *triples)
{
    GUARDED(list_triangles(nodes, deviation, n_edges, edges, led, leds, most, triples));
}

/* Begin a hypothesis at each of `count` sets of nodes (count, corners), with one of the rotations
 * (n_rotations, 3, 3), taken in turn. */
int64_t entry_begin_poses(const int64_t *spots, const double *rig, const int64_t *point,
                          const int64_t *led, int64_t count, int64_t corners, const int64_t *nodes,
                          int64_t n_leds, const double *leds, int64_t n_rotations,
                          const double *rotation, double position, double turn, double shift,
                          double *state, int64_t *spot)
{
    Points points = {.spot = spots, .rig = rig};
    for (int64_t h = 0; h < count; h++)
        begin_pose(&points, (Nodes){point, led}, (int)corners, nodes + h * corners, n_leds, leds,
                   rotation + 9 * (h % n_rotations), (double[]){position, turn, shift},
                   state + h * N_STATE, spot + h * 2 * n_leds);
    return 0;
}
