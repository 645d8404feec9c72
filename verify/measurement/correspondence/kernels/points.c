/* Rays a, b from the centres c1, c2 have the common normal n = a x b; their feet on it are at
 *
 *     c1 + a ((c2 - c1) x b) . n / n^2  and  c2 + b ((c2 - c1) x a) . n / n^2
 *
 * and the gap is the feet's distance. Each spot of one image is tried with each of the other.
 */
#include "verify/measurement/correspondence/kernels/points.h"

#include "verify/core/kernels/linear_algebra.h"
#include "verify/core/kernels/scratch.h"
#include "verify/measurement/correspondence/kernels/fit.h"

#define MAX_DEPTH 10.0    /* m, no camera of this kind resolves a marker there */
#define MIN_MARKER_PX 8.0 /* px, a marker that looks smaller than this cannot be read */
#define MIN_SIN2 1e-18    /* squared sine of the angle between rays, as in triangulation.py */

int64_t insert_cost(double cost, const int64_t *row, int width, int64_t most, double *costs,
                    int64_t *rows, int64_t count)
{
    bool full = count == most;
    if (full && (count == 0 || !(cost < costs[count - 1])))
        return count;
    int64_t place = full ? count - 1 : count;
    for (; place > 0 && cost < costs[place - 1]; place--) {
        costs[place] = costs[place - 1];
        for (int k = 0; k < width; k++)
            rows[place * width + k] = rows[(place - 1) * width + k];
    }
    costs[place] = cost;
    for (int k = 0; k < width; k++)
        rows[place * width + k] = row[k];
    return full ? count : count + 1;
}

/* Fill in the point (3,) midway between rays a and b (3,) from two centres (2, 3).
 *
 * Gives the gap between the rays, m; NaN, and no point, where they are parallel or meet behind a
 * camera. Source: verify.measurement.triangulation.ray_midpoints. */
static double ray_midpoint(const double *center, const double *a, const double *b, double *point)
{
    double normal[3], aside_a[3], aside_b[3];
    cross(a, b, normal);
    double size = dot(normal, normal);
    if (!(size > MIN_SIN2 * (dot(a, a) * dot(b, b))))
        return NAN;
    double base[3] = {center[3] - center[0], center[4] - center[1], center[5] - center[2]};
    cross(base, b, aside_b);
    cross(base, a, aside_a);
    double along_a = dot(aside_b, normal), along_b = dot(aside_a, normal), gap = 0.0;
    if (!(along_a > 0.0 && along_b > 0.0))
        return NAN;
    for (int i = 0; i < 3; i++) {
        double foot_a = center[i] + along_a / size * a[i];
        double foot_b = center[3 + i] + along_b / size * b[i];
        point[i] = (foot_a + foot_b) / 2.0;
        gap += square(foot_b - foot_a);
    }
    return sqrt(gap);
}

/* Depth, m, beyond which the marker is too small in the image. */
static double farthest_depth(const Scene *scene, double mean_focal)
{
    double size = 0.0;
    for (int64_t one = 0; one < scene->n_leds; one++)
        for (int64_t other = 0; other < one; other++)
            size = MAX(size, distance(scene->leds + 3 * one, scene->leds + 3 * other));
    return scene->n_leds > 1 ? MIN(size * mean_focal / MIN_MARKER_PX, MAX_DEPTH) : MAX_DEPTH;
}

/* Fill in the rays (2, s, 3) of the spots, of unit depth, rig axes. */
static void fill_rays(const Scene *scene, double *rays)
{
    for (int side = 0; side < 2; side++) {
        const double *turn = scene->camera_R_rig + 9 * side, *focal = scene->focal + 2 * side;
        for (int64_t k = side * scene->n_spots; k < (side + 1) * scene->n_spots; k++) {
            double x = scene->pixels[2 * k] / focal[0], y = scene->pixels[2 * k + 1] / focal[1];
            for (int i = 0; i < 3; i++)
                rays[3 * k + i] = x * turn[i] + y * turn[3 + i] + turn[6 + i];
        }
    }
}

/* Whether an LED may be these two spots. */
static bool same_colour(const Scene *scene, int64_t left, int64_t right)
{
    const bool *allowed = scene->allowed + left, *other = scene->allowed + right;
    for (int64_t led = 0; led < scene->n_leds; led++)
        if (allowed[led * scene->n_spots] && other[(scene->n_leds + led) * scene->n_spots])
            return true;
    return false;
}

/* Fill in the covariance (3, 3), m^2, of a point (3,), m, of two spots (2,), left and right. */
static void locate_point(const Scene *scene, const int64_t *spot, const double *point,
                         double *covariance)
{
    double information[9] = {0.0}, root[9], local[3], slope[3];
    for (int side = 0; side < 2; side++) {
        const double *turn = scene->camera_R_rig + 9 * side, *center = scene->center + 3 * side;
        const double *spread = scene->covariance + 4 * (side * scene->n_spots + spot[side]);
        double from[3] = {point[0] - center[0], point[1] - center[1], point[2] - center[2]};
        for (int i = 0; i < 3; i++)
            local[i] = dot(turn + 3 * i, from);
        for (int axis = 0; axis < 2; axis++) {
            double scale = scene->focal[2 * side + axis] / local[2];
            double lean = -local[axis] * scale / local[2], weight = 1.0 / spread[3 * axis];
            for (int j = 0; j < 3; j++)
                slope[j] = scale * turn[3 * axis + j] + lean * turn[6 + j];
            for (int i = 0; i < 3; i++)
                for (int j = 0; j < 3; j++)
                    information[3 * i + j] += slope[i] * weight * slope[j];
        }
    }
    factor(3, information, 0.0, root);
    invert(3, root, covariance);
}

/* List pairs of spots on each other's epipolar line (c, 2), left and right, best first; gives c.
 *
 * `mean_focal`, px; `skew`, px, by how much the marker may have moved between the images. At most
 * `most` pairs are listed, by mismatch over its noise. Filled beside: their points, (c, 3), m, and
 * the points' covariance, (c, 3, 3), m^2. */
static int64_t find_points(const Scene *scene, double mean_focal, double skew, int64_t most,
                           int64_t *spot, double *rig, double *spread)
{
    Mark mark = scratch_mark();
    int64_t n = scene->n_spots, count = 0;
    double *costs = TAKE(double, most), *rays = TAKE(double, 2 * n * 3);
    const double *a = scene->covariance, *b = a + 4 * n, *deep = scene->camera_R_rig + 6;
    double farthest = farthest_depth(scene, mean_focal);
    fill_rays(scene, rays);
    for (int64_t left = 0; left < n; left++) {
        for (int64_t right = 0; right < n; right++) {
            double point[3] = {0.0}, depth = 0.0;
            double gap =
                ray_midpoint(scene->center, rays + 3 * left, rays + 3 * (n + right), point);
            for (int i = 0; i < 3; i++)
                depth += (point[i] - scene->center[i]) * deep[i];
            double noise = sqrt((a[4 * left] + a[4 * left + 3]) / 2.0
                                + (b[4 * right] + b[4 * right + 3]) / 2.0);
            double mismatch = gap * mean_focal / depth;
            /* NaN, rays that do not meet, fails */
            if (mismatch <= skew + MAX_DEVIATION * noise && depth < farthest
                && same_colour(scene, left, right))
                count = insert_cost(mismatch / noise, (int64_t[]){left, right}, 2, most, costs,
                                    spot, count);
        }
    }
    for (int64_t c = 0; c < count; c++) {
        const int64_t *own = spot + 2 * c;
        ray_midpoint(scene->center, rays + 3 * own[0], rays + 3 * (n + own[1]), rig + 3 * c);
        locate_point(scene, own, rig + 3 * c, spread + 9 * c);
    }
    scratch_release(mark);
    return count;
}

int64_t entry_find_points(
    const double *camera_R_rig, const double *center, const double *focal, int64_t n_spots,
    const double *pixels, const double *covariance, const bool *merged, const bool *allowed,
    int64_t n_leds, const double *leds, double mean_focal, double skew, int64_t most,
    int64_t *spot, double *rig, double *spread)
{
    GUARDED(find_points(SCENE(0.0, 0.0, 0.0), mean_focal, skew, most, spot, rig, spread));
}
