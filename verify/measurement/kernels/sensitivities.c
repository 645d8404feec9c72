/* Fill in the derivatives of spots by the parameters of cameras, LEDs and their body.
 *
 * A parameter that moves a camera by the twist (t, w) moves the spot of a point x, g its
 * derivative by the point, by -(g . t + w . (x x g)); lens and focal length move it by their own
 * derivative.
 */
#include "verify/core/kernels/camera.h"
#include "verify/core/kernels/linear_algebra.h"
#include "verify/core/kernels/scratch.h"

enum { MIDDLE, FOCAL, LENS, MOTION };
enum { LED, SHIFT, TURN };

typedef struct { /* one camera's k parameters, and the camera itself */
    int64_t k;
    const int64_t *kinds; /* (k, 3): the parameter's column, what it is, which one of its kind */
    const double *twists; /* (k, 6), how it moves the camera: translation at the rig's origin (m)
                           * and turn */
    const double *matrix, *lens; /* (3, 3), px; k1, k2, p1, p2, k3 */
    const double *camera_T_rig;  /* (4, 4) */
} StatedCamera;

typedef struct { /* n spots, those of the left camera first */
    int64_t n, n_left;
    const double *leds;         /* (., 3), m, flange frame */
    const int64_t *led;         /* (n,), of each spot */
    const double *rig_T_flange; /* (4, 4) */
    const double *by_point;     /* (n, 2, 3), d px / d point in the rig */
} StatedSpots;

/* Fill in how one camera's parameters move n of its spots.
 *
 * `inside` and `points` (n, 3), m, in the camera and in the rig, and `by_point` (n, 2, 3), d px / d
 * point in the rig. `moved` (p, all, 2), px a SI unit, zeros: those of the spots, from `first` on,
 * are filled. */
static void fill_by_camera(StatedCamera of, int64_t n, const double *inside, const double *points,
                           const double *by_point, int64_t first, int64_t all, double *moved)
{
    for (int64_t s = 0; s < n; s++) {
        const double *point = points + 3 * s;
        double x = inside[3 * s] / inside[3 * s + 2], y = inside[3 * s + 1] / inside[3 * s + 2];
        double by_lens[5][2], about[3];
        Bent ray = bend(of.lens, x, y);
        differentiate_lens(x, y, by_lens);
        for (int64_t p = 0; p < of.k; p++) {
            int64_t kind = of.kinds[3 * p + 1], which = of.kinds[3 * p + 2];
            double *to = moved + 2 * (of.kinds[3 * p] * all + first + s);
            if (kind == MIDDLE)
                to[which] = 1.0;
            if (kind == FOCAL)
                to[which] = which ? ray.y : ray.x;
            for (int axis = 0; axis < 2; axis++) {
                const double *slope = by_point + 6 * s + 3 * axis, *row = of.matrix + 3 * axis;
                if (kind == LENS) {
                    to[axis] = row[0] * by_lens[which][0] + row[1] * by_lens[which][1];
                } else if (kind == MOTION) {
                    cross(point, slope, about);
                    const double *twist = of.twists + 6 * p;
                    to[axis] = -(dot(slope, twist) + dot(twist + 3, about));
                }
            }
        }
    }
}

/* Fill in how LEDs, and the body that holds them, move the spots.
 *
 * `kinds` (k, 4): the parameter's column, what it is, its LED, its axis of the flange; `offset`
 * (n, 3), m, LED from flange, rig axes; `moved` as above, its columns filled. */
static void fill_by_body(int64_t k, const int64_t *kinds, const StatedSpots *spots,
                         const double *offset, double *moved)
{
    for (int64_t p = 0; p < k; p++) {
        const int64_t *kind = kinds + 4 * p;
        const double *axis = spots->rig_T_flange + kind[3];
        double straight[3] = {axis[0], axis[4], axis[8]}, turned[3];
        for (int64_t s = 0; s < spots->n; s++) {
            if (kind[1] == LED && spots->led[s] != kind[2])
                continue;
            cross(straight, offset + 3 * s, turned);
            for (int i = 0; i < 2; i++)
                moved[2 * (kind[0] * spots->n + s) + i] =
                    dot(spots->by_point + 6 * s + 3 * i, kind[1] == TURN ? turned : straight);
        }
    }
}

/* Fill in how all parameters move the spots, `moved` as above. */
static int64_t fill_derivatives(const StatedSpots *spots, int64_t k, const int64_t *kinds,
                                const StatedCamera *cameras, double *moved)
{
    int64_t n = spots->n;
    double *offset = TAKE(double, 3 * n), *points = TAKE(double, 3 * n);
    double *inside = TAKE(double, 3 * n);
    for (int64_t s = 0; s < n; s++) {
        double *point = points + 3 * s;
        place_point(spots->rig_T_flange, spots->leds + 3 * spots->led[s], point);
        for (int i = 0; i < 3; i++)
            offset[3 * s + i] = point[i] - spots->rig_T_flange[4 * i + 3];
        place_point(cameras[s >= spots->n_left].camera_T_rig, point, inside + 3 * s);
    }
    fill_by_body(k, kinds, spots, offset, moved);
    for (int side = 0; side < 2; side++) {
        int64_t first = side ? spots->n_left : 0, count = side ? n - first : spots->n_left;
        fill_by_camera(cameras[side], count, inside + 3 * first, points + 3 * first,
                       spots->by_point + 6 * first, first, n, moved);
    }
    return 0;
}

int64_t entry_fill_by_camera(int64_t k, const int64_t *kinds, const double *twists,
                             const double *matrix, const double *lens, int64_t n,
                             const double *inside, const double *points, const double *by_point,
                             double *moved)
{
    fill_by_camera((StatedCamera){k, kinds, twists, matrix, lens, NULL}, n, inside, points,
                   by_point, 0, n, moved);
    return 0;
}

/* Arguments as in `StatedSpots`, `fill_by_body` and, of the left camera and of the right one,
 * `StatedCamera`; `moved` (p, n, 2), px a SI unit, zeros. */
int64_t entry_fill_derivatives(
    int64_t n, int64_t n_left, const double *leds, const int64_t *led, const double *rig_T_flange,
    const double *by_point, int64_t k, const int64_t *kinds, int64_t k1, const int64_t *kinds1,
    const double *twists1, const double *matrix1, const double *lens1, const double *placed1,
    int64_t k2, const int64_t *kinds2, const double *twists2, const double *matrix2,
    const double *lens2, const double *placed2, double *moved)
{
    StatedSpots spots = {n, n_left, leds, led, rig_T_flange, by_point};
    StatedCamera cameras[2] = {{k1, kinds1, twists1, matrix1, lens1, placed1},
                               {k2, kinds2, twists2, matrix2, lens2, placed2}};
    GUARDED(fill_derivatives(&spots, k, kinds, cameras, moved));
}
