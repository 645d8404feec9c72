/* Fill in the derivatives of spots by the parameters of cameras, LEDs and their body.
 *
 * A parameter that moves a camera by the twist (t, w) moves the spot of a point x, g its
 * derivative by the point, by -(g . t + w . (x x g)); lens and focal length move it by their own
 * derivative.
 */
#include "verify/core/kernels/camera.h"
#include "verify/core/kernels/linear_algebra.h"

enum { MIDDLE, FOCAL, LENS, MOTION };
enum { LED, SHIFT, TURN };

/* Place the LEDs (., 3), m, flange frame, of n spots. Of camera_T_rig, (4, 4), `left` is for the
 * first `n_left` ones. `placed` (3, n, 3), m: LED from flange, rig axes; in the rig; in the
 * camera. */
int64_t entry_place_leds(int64_t n, const double *leds, const int64_t *led,
                         const double *rig_T_flange, const double *left, const double *right,
                         int64_t n_left, double *placed)
{
    for (int64_t s = 0; s < n; s++) {
        double *offset = placed + 3 * s, *point = offset + 3 * n, *inside = point + 3 * n;
        place_point(rig_T_flange, leds + 3 * led[s], point);
        for (int i = 0; i < 3; i++)
            offset[i] = point[i] - rig_T_flange[4 * i + 3];
        place_point(s < n_left ? left : right, point, inside);
    }
    return 0;
}

/* Fill in how one camera's parameters move its spots.
 *
 * `kinds` (k, 3): the parameter's column, what it is, which one of its kind; `twists` (k, 6),
 * how it moves the camera: translation at the rig's origin (m) and turn; `matrix` (3, 3), px;
 * `lens`: k1, k2, p1, p2, k3; of the camera's n spots, `inside` and `points` (n, 3), m, in the
 * camera and in the rig, and `by_point` (n, 2, 3), d px / d point in the rig. `moved` (p, all,
 * 2), px a SI unit, zeros: those of its spots, from `first` on, are filled. */
int64_t entry_fill_by_camera(int64_t k, const int64_t *kinds, const double *twists,
                             const double *matrix, const double *lens, int64_t n,
                             const double *inside, const double *points, const double *by_point,
                             int64_t first, int64_t all, double *moved)
{
    for (int64_t s = 0; s < n; s++) {
        const double *point = points + 3 * s;
        double x = inside[3 * s] / inside[3 * s + 2], y = inside[3 * s + 1] / inside[3 * s + 2];
        double by_lens[5][2], about[3];
        Bent ray = bend(lens, x, y);
        differentiate_lens(x, y, by_lens);
        for (int64_t p = 0; p < k; p++) {
            int64_t kind = kinds[3 * p + 1], which = kinds[3 * p + 2];
            double *to = moved + 2 * (kinds[3 * p] * all + first + s);
            if (kind == MIDDLE)
                to[which] = 1.0;
            if (kind == FOCAL)
                to[which] = which ? ray.y : ray.x;
            for (int axis = 0; axis < 2; axis++) {
                const double *slope = by_point + 6 * s + 3 * axis, *row = matrix + 3 * axis;
                if (kind == LENS) {
                    to[axis] = row[0] * by_lens[which][0] + row[1] * by_lens[which][1];
                } else if (kind == MOTION) {
                    cross(point, slope, about);
                    to[axis] = -(dot(slope, twists + 6 * p) + dot(twists + 6 * p + 3, about));
                }
            }
        }
    }
    return 0;
}

/* Fill in how LEDs, and the body that holds them, move the spots.
 *
 * `kinds` (k, 4): the parameter's column, what it is, its LED, its axis of the flange; `led`
 * (n,), of each spot; `rig_R_flange` (3, 3); `offset` (n, 3), m, LED from flange, rig axes;
 * `by_point` (n, 2, 3), d px / d point in the rig; `moved` (p, n, 2), px a SI unit, its columns
 * filled. */
int64_t entry_fill_by_body(int64_t k, const int64_t *kinds, int64_t n, const int64_t *led,
                           const double *rig_R_flange, const double *offset,
                           const double *by_point, double *moved)
{
    for (int64_t p = 0; p < k; p++) {
        const int64_t *kind = kinds + 4 * p;
        const double *axis = rig_R_flange + kind[3];
        double straight[3] = {axis[0], axis[3], axis[6]}, turned[3];
        for (int64_t s = 0; s < n; s++) {
            if (kind[1] == LED && led[s] != kind[2])
                continue;
            cross(straight, offset + 3 * s, turned);
            for (int i = 0; i < 2; i++)
                moved[2 * (kind[0] * n + s) + i] =
                    dot(by_point + 6 * s + 3 * i, kind[1] == TURN ? turned : straight);
        }
    }
    return 0;
}
