/* Project corners of boards, and differentiate their pixels by all that moves them.
 *
 * Of each corner of one camera (whitened, two rows): 40 columns,
 *
 *     0 - 21   the camera's parameters, as in parameters.py
 *     22 - 24  the board's bow
 *     25 - 38  the board's own: pose (6), pan errors (2), motion (3), bend (3)
 *     39       observed less predicted
 *
 * Of n corners, `board` (n,) says which board is each one's, `modes` (n, 3) are of the bow; `arms`,
 * `points` and `seen` (n, 3), m, from the board's origin, the rig's and the camera's. Of b boards,
 * `poses` are rig_T_board and `placed` rig_T_camera, (b, 4, 4). `side`: 0 left, 1 right camera.
 */
#include <stdint.h>

#include "verify/core/kernels/linear_algebra.h"

enum { COL_FOCAL = 0, COL_PRINCIPAL = 2, COL_LENS = 4, COL_CENTER = 9, COL_AXIS = 12, COL_ZERO = 15,
       COL_TURN = 16, COL_OFFSET = 19, COL_BOW = 22, COL_POSE = 25, COL_PAN = 31, COL_MOTION = 33,
       COL_BEND = 36, COL_RESIDUAL = 39, N_COLUMNS = 40 };

enum { FX, FY, CX, CY, K1, K2, P1, P2, K3 }; /* of a lens (9,) */

/* A corner's place at depth 1, x and y, and where the lens shows it, u and v. */
typedef struct {
    double x, y, r2, across, radial, u, v;
} Ray;

static Ray bend_ray(double x, double y, const double *lens)
{
    double r2 = x * x + y * y, across = 2.0 * x * y;
    double radial = 1.0 + r2 * (lens[K1] + r2 * (lens[K2] + r2 * lens[K3]));
    double u = x * radial + lens[P1] * across + lens[P2] * (r2 + 2.0 * x * x);
    double v = y * radial + lens[P1] * (r2 + 2.0 * y * y) + lens[P2] * across;
    return (Ray){x, y, r2, across, radial, u, v};
}

/* Place the corners and project them.
 *
 * `flat` (n, 3) is where they are on a flat board; `moved` (b, 6): motion from left to right, and
 * the bow with the bend. Pixels (n, 2) are NaN behind the camera. */
int64_t entry_see_corners(int64_t n, const int64_t *board, const double *flat, const double *modes,
                          const double *poses, const double *moved, const double *lens,
                          const double *placed, int64_t side, double *restrict arms,
                          double *restrict points, double *restrict seen, double *restrict pixels)
{
    for (int64_t k = 0; k < n; k++) {
        const double *pose = poses + 16 * board[k], *camera = placed + 16 * board[k];
        const double *motion = moved + 6 * board[k], *bow = motion + 3;
        double place[3] = {flat[3 * k], flat[3 * k + 1], flat[3 * k + 2] + dot(bow, modes + 3 * k)};
        double from[3] = {0.0, 0.0, 0.0};
        for (int i = 0; i < 3; i++) {
            double arm = dot(pose + 4 * i, place);
            double point = arm + pose[4 * i + 3] + (double)side * motion[i];
            for (int j = 0; j < 3; j++)
                from[j] += camera[4 * i + j] * (point - camera[4 * i + 3]);
            arms[3 * k + i] = arm;
            points[3 * k + i] = point;
        }
        copy(seen + 3 * k, from, 3);
        double depth = from[2] > 0.0 ? from[2] : NAN;
        Ray ray = bend_ray(from[0] / depth, from[1] / depth, lens);
        pixels[2 * k] = lens[FX] * ray.u + lens[CX];
        pixels[2 * k + 1] = lens[FY] * ray.v + lens[CY];
    }
    return 0;
}

/* Fill in a row's derivatives by the lens, where its weights are `one` of u and `two` of v; and by
 * the corner's place in the camera's axes (3,). */
static void fill_lens(Ray ray, double depth, double one, double two, const double *lens,
                      double *restrict inside, double *restrict c)
{
    double x = ray.x, y = ray.y, r2 = ray.r2, fx = one * lens[FX], fy = two * lens[FY];
    double slope = 2.0 * (lens[K1] + r2 * (2.0 * lens[K2] + r2 * 3.0 * lens[K3]));
    double mixed = x * y * slope + 2.0 * (lens[P1] * x + lens[P2] * y);
    double by_x = ray.radial + x * x * slope + 2.0 * lens[P1] * y + 6.0 * lens[P2] * x;
    double by_y = ray.radial + y * y * slope + 6.0 * lens[P1] * y + 2.0 * lens[P2] * x;
    c[COL_FOCAL] = one * ray.u;
    c[COL_FOCAL + 1] = two * ray.v;
    c[COL_PRINCIPAL] = one;
    c[COL_PRINCIPAL + 1] = two;
    c[COL_LENS] = (fx * x + fy * y) * r2;
    c[COL_LENS + 1] = (fx * x + fy * y) * r2 * r2;
    c[COL_LENS + 2] = fx * ray.across + fy * (r2 + 2.0 * y * y);
    c[COL_LENS + 3] = fx * (r2 + 2.0 * x * x) + fy * ray.across;
    c[COL_LENS + 4] = (fx * x + fy * y) * r2 * r2 * r2;
    inside[0] = (fx * by_x + fy * mixed) / depth;
    inside[1] = (fx * mixed + fy * by_y) / depth;
    inside[2] = -(inside[0] * x + inside[1] * y);
}

/* Fill in a row's derivatives by all that moves camera or board, from those by the corner's place
 * in the rig's axes (3,). Points move against the camera: a turn u about o moves a point r from o
 * by -(u x r). `turned` (3, 3): the turntable's axes in the rig's. */
static void fill_motions(const double *by_point, const double *point, const double *arm,
                         const double *camera, const double *turned, const double *center,
                         const double *axis, int64_t side, double *restrict c)
{
    double from_center[3], from_camera[3], about[3], spun[3];
    for (int i = 0; i < 3; i++) {
        from_center[i] = point[i] - center[i];
        from_camera[i] = point[i] - camera[4 * i + 3];
    }
    cross(by_point, from_center, about);
    cross(by_point, from_camera, spun);
    cross(arm, by_point, c + COL_POSE + 3);
    c[COL_ZERO] = c[COL_PAN + side] = dot(axis, about);
    for (int i = 0; i < 3; i++) {
        double column[3] = {turned[i], turned[3 + i], turned[6 + i]};
        c[COL_CENTER + i] = -by_point[i];
        c[COL_POSE + i] = by_point[i];
        c[COL_AXIS + i] = about[i] - dot(about, column);
        c[COL_TURN + i] = dot(spun, column);
        c[COL_OFFSET + i] = -dot(by_point, column);
        c[COL_MOTION + i] = (double)side * by_point[i];
    }
}

/* Fill in the derivatives (n, 2, 40) of corners whose residuals (n, 2), px, stand behind them.
 *
 * `turned` (b, 3, 3): the turntable's axes in the rig's; pan centre and axis (3,); `root` (n, 2, 2)
 * whitens. The other side's pan error is left alone. */
int64_t entry_fill_columns(int64_t n, const int64_t *board, const double *poses,
                           const double *modes, const double *turned, const double *center,
                           const double *axis, const double *lens, const double *placed,
                           int64_t side, const double *arms, const double *points,
                           const double *seen, const double *root, double *restrict columns)
{
    for (int64_t k = 0; k < n; k++) {
        const double *from = seen + 3 * k, *camera = placed + 16 * board[k];
        const double *pose = poses + 16 * board[k];
        Ray ray = bend_ray(from[0] / from[2], from[1] / from[2], lens);
        double *rows = columns + 2 * N_COLUMNS * k;
        double off_x = rows[COL_RESIDUAL], off_y = rows[N_COLUMNS + COL_RESIDUAL];
        for (int row = 0; row < 2; row++) {
            double *c = rows + row * N_COLUMNS, inside[3], by_point[3], height = 0.0;
            const double *weight = root + 4 * k + 2 * row;
            fill_lens(ray, from[2], weight[0], weight[1], lens, inside, c);
            for (int i = 0; i < 3; i++) {
                by_point[i] = dot(inside, camera + 4 * i);
                height += by_point[i] * pose[4 * i + 2];
            }
            fill_motions(by_point, points + 3 * k, arms + 3 * k, camera, turned + 9 * board[k],
                         center, axis, side, c);
            for (int i = 0; i < 3; i++)
                c[COL_BOW + i] = c[COL_BEND + i] = height * modes[3 * k + i];
            c[COL_RESIDUAL] = weight[0] * off_x + weight[1] * off_y;
        }
    }
    return 0;
}
