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

#include "verify/core/kernels/camera.h"
#include "verify/core/kernels/linear_algebra.h"

enum { COL_FOCAL = 0, COL_PRINCIPAL = 2, COL_LENS = 4, COL_CENTER = 9, COL_AXIS = 12, COL_ZERO = 15,
       COL_TURN = 16, COL_OFFSET = 19, COL_BOW = 22, COL_POSE = 25, COL_PAN = 31, COL_MOTION = 33,
       COL_BEND = 36, COL_RESIDUAL = 39, N_COLUMNS = 40 };

enum { FX, FY, CX, CY, LENS }; /* of a camera (9,) */

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
        Bent ray = bend(lens + LENS, from[0] / depth, from[1] / depth);
        pixels[2 * k] = lens[FX] * ray.x + lens[CX];
        pixels[2 * k + 1] = lens[FY] * ray.y + lens[CY];
    }
    return 0;
}

/* Fill in two rows' derivatives by the lens, and by the corner's place in the camera's axes (2, 3),
 * where `root` (2, 2) weighs the two coordinates. */
static void fill_lens(const double *from, const double *root, const double *lens, double *inside,
                      double *restrict rows)
{
    double x = from[0] / from[2], y = from[1] / from[2], by_lens[5][2];
    Bent ray = bend(lens + LENS, x, y);
    differentiate_lens(x, y, by_lens);
    for (int row = 0; row < 2; row++, root += 2, inside += 3) {
        double *c = rows + row * N_COLUMNS, fx = root[0] * lens[FX], fy = root[1] * lens[FY];
        c[COL_FOCAL] = root[0] * ray.x;
        c[COL_FOCAL + 1] = root[1] * ray.y;
        copy(c + COL_PRINCIPAL, root, 2);
        for (int i = 0; i < 5; i++)
            c[COL_LENS + i] = fx * by_lens[i][0] + fy * by_lens[i][1];
        inside[0] = (fx * ray.xx + fy * ray.xy) / from[2];
        inside[1] = (fx * ray.xy + fy * ray.yy) / from[2];
        inside[2] = -(inside[0] * x + inside[1] * y);
    }
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
        double *rows = columns + 2 * N_COLUMNS * k, inside[6];
        double off_x = rows[COL_RESIDUAL], off_y = rows[N_COLUMNS + COL_RESIDUAL];
        fill_lens(from, root + 4 * k, lens, inside, rows);
        for (int row = 0; row < 2; row++) {
            double *c = rows + row * N_COLUMNS, by_point[3], height = 0.0;
            const double *weight = root + 4 * k + 2 * row;
            for (int i = 0; i < 3; i++) {
                by_point[i] = dot(inside + 3 * row, camera + 4 * i);
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
