/* Predict the spots of a pose, and fit a pose to spots by Gauss-Newton.
 *
 * With z the spots of both images, u(T) their prediction, D its derivative by the pose, C the
 * spots' covariance from pixels and a from an unknown acceleration, each step is
 *
 *     (D' (C + a)^-1 D)^-1 D' (C + a)^-1 (z - u(T))
 *
 * restricted to the directions that the spots determine.
 */
#include "verify/core/kernels/camera.h"
#include "verify/core/kernels/linear_algebra.h"
#include "verify/core/kernels/scratch.h"
#include "verify/measurement/kernels/directions.h"

#define MAX_ITERATIONS 25
/* Acceleration assumed a speed, 1/s: arms move in sines near 0.5 Hz (2 pi f = 3) or in ramps of a
 * third of a second. The session's own motion corrects it afterwards (comparison.py). */
#define ACCELERATION_PER_SPEED 3.0
#define MOTION_RATE 3.0 /* likewise: of jerk an acceleration, of snap a jerk, 1/s */
#define MIN_LINEAR 0.02 /* m/s^2: a slow arm still starts and stops */
#define MIN_ANGULAR 0.1 /* rad/s^2 */
#define TIME_STEP 0.01 /* s, of the image's acceleration: long against rounding, short a motion */
#define TOL_STEP 1e-10 /* m and rad: a thousandth of the smallest uncertainty that pixels allow */
#define RIDGE 1e-6 /* of the mean information: keeps the motion of one or two LEDs solvable */
#define CLEAN_PX 0.1 /* px, standard uncertainty up to which the velocities of spots count alike */
#define MIN_VARIANCE 1e-6 /* px^2: against 0/0 where nothing else checks a spot */

enum { BENDING = 12, MATRIX = 17, N_CAMERA = 23 }; /* where a camera's figures stand in its row */

typedef struct { /* n spots, n_left of the left camera first */
    int64_t n, n_left;
    const double *points; /* (n, 3), m, LEDs in the flange frame */
    const double *cameras; /* (2, 23): camera_T_rig (3, 4), lens (5,), matrix (2, 3), px */
    const double *centre; /* (n, 2), px, as measured; not for a prediction, nor what follows */
    const double *covariance; /* (n, 2, 2), px^2 */
    const double *velocity; /* (n, 2), px/s */
    const double *lever; /* (n, 3), s^2, s^3, s^4, of acceleration, jerk and snap */
} Spots;

typedef struct { /* coordinates of the spots that count, of n */
    int64_t n, count;
    const int64_t *rows; /* (count,) */
} Kept;

typedef struct { /* a pose's fit to n spots */
    double *residual; /* (n, 2), px, before the last step, as are the derivatives */
    double *by_point; /* (n, 2, 3), px/m, of the spots by the point in the rig */
    double *by_pose; /* (n, 2, 6), by a translation and a rotation vector in rig axes */
    double *noise; /* (2 n, 2 n), px^2, covariance of the spots from the pixels */
    double *acceleration; /* (2 n, 2 n), from motion that is not known */
    double *gain; /* (6, 2 n), d pose / d spot, 0 for spots that do not count */
    double *directions; /* (6, 6), of `covariance_of` */
    bool *known; /* (6,) */
    double *twist; /* (6,), m/s and rad/s */
    double *curvature; /* (n, 2), px/s^2, image acceleration of the twist, corrected for */
    double *covariances; /* (2, 6, 6), of the pose by noise and by acceleration */
    double *uncertainty; /* (n,), px, of a spot in a coordinate, by both */
    double *figures; /* acceleration assumed, a component, m/s^2 and rad/s^2; chi^2 of residuals */
} Fit;

/* Fill in the spots' images (n, 2) at a pose (4, 4), and how they change with point and pose. */
static void predict_spots(const double *pose, const Spots *at, double *pixels, double *by_point,
                          double *by_pose)
{
    for (int64_t s = 0; s < at->n; s++) {
        const double *camera = at->cameras + N_CAMERA * (s >= at->n_left);
        double placed[3], arm[3], inside[3];
        place_point(pose, at->points + 3 * s, placed);
        for (int i = 0; i < 3; i++)
            arm[i] = placed[i] - pose[4 * i + 3];
        place_point(camera, placed, inside);
        double depth = inside[2], x = inside[0] / depth, y = inside[1] / depth;
        Bent bent = bend(camera + BENDING, x, y);
        for (int64_t row = 2 * s; row < 2 * s + 2; row++) {
            const double *matrix = camera + MATRIX + 3 * (row % 2);
            double *slope = by_point + 3 * row;
            double by_x = (matrix[0] * bent.xx + matrix[1] * bent.xy) / depth;
            double by_y = (matrix[0] * bent.xy + matrix[1] * bent.yy) / depth;
            double by_depth = -(by_x * x + by_y * y);
            pixels[row] = matrix[0] * bent.x + matrix[1] * bent.y + matrix[2];
            for (int i = 0; i < 3; i++)
                slope[i] = by_x * camera[i] + by_y * camera[4 + i] + by_depth * camera[8 + i];
            copy(by_pose + N_FREE * row, slope, 3);
            cross(arm, slope, by_pose + N_FREE * row + 3);
        }
    }
}

/* Fill in the image acceleration of the spots at a pose under a steady twist.
 *
 * LEDs that turn about the flange, and points that come nearer, do not cross the image at a steady
 * rate even then. It points one way, so it would not average out. */
static void image_acceleration(const Spots *spots, const double *pose, const Fit *fit)
{
    Mark mark = scratch_mark();
    int64_t n = spots->n;
    double *pixels = TAKE(double, 2 * n), *by_point = TAKE(double, 6 * n);
    double *by_pose = TAKE(double, 2 * N_FREE * n);
    clear(fit->curvature, 2 * n);
    for (int h = -1; h <= 1; h++) {
        double moved[16], step[N_FREE], share = (h ? 1.0 : -2.0) / square(TIME_STEP);
        copy(moved, pose, 16);
        for (int i = 0; i < N_FREE; i++)
            step[i] = fit->twist[i] * (h * TIME_STEP);
        move_pose(moved, step);
        predict_spots(moved, spots, pixels, by_point, by_pose);
        for (int64_t i = 0; i < 2 * n; i++)
            fit->curvature[i] += share * pixels[i];
    }
    scratch_release(mark);
}

/* Fill in how the flange moves, from the velocities of the kept spots, and the acceleration that
 * this suggests. Clean spots count alike, doubtful ones hardly. */
static void twist_from_velocities(const Spots *spots, Kept kept, const Fit *fit)
{
    double information[N_FREE * N_FREE] = {0.0}, root[N_FREE * N_FREE], trace = 0.0;
    double *twist = fit->twist, *prior = fit->figures;
    bool moving = false;
    prior[0] = MIN_LINEAR;
    prior[1] = MIN_ANGULAR;
    clear(twist, N_FREE);
    for (int64_t r = 0; r < kept.count; r++) {
        int64_t row = kept.rows[r];
        double variance = spots->covariance[2 * row + row % 2], scaled[N_FREE];
        double share = square(CLEAN_PX) / (square(CLEAN_PX) + variance);
        moving = moving || spots->velocity[row] != 0.0;
        for (int i = 0; i < N_FREE; i++)
            scaled[i] = fit->by_pose[N_FREE * row + i] * SCALE[i];
        for (int i = 0; i < N_FREE; i++) {
            twist[i] += share * scaled[i] * spots->velocity[row];
            trace += share * square(scaled[i]);
            for (int j = 0; j < N_FREE; j++)
                information[i * N_FREE + j] += share * scaled[i] * scaled[j];
        }
    }
    if (!moving)
        return;
    factor(N_FREE, information, -RIDGE * trace / N_FREE, root);
    solve(N_FREE, root, twist);
    for (int i = 0; i < N_FREE; i++)
        twist[i] *= SCALE[i];
    for (int part = 0; part < 2; part++) {
        double speed = sqrt(dot(twist + 3 * part, twist + 3 * part));
        prior[part] = (prior[part] + ACCELERATION_PER_SPEED * speed) / sqrt(3.0);
    }
}

/* Fill in the covariance of the spots by its sources. */
static void spot_covariance(const Spots *spots, const Fit *fit)
{
    int64_t n = 2 * spots->n;
    double linear = square(fit->figures[0]), angular = square(fit->figures[1]);
    double rate = square(MOTION_RATE);
    clear(fit->noise, n * n);
    for (int64_t i = 0; i < n; i++) {
        const double *a = fit->by_pose + N_FREE * i, *lever = spots->lever + i / 2 * 3;
        copy(fit->noise + n * i + i / 2 * 2, spots->covariance + 2 * i, 2);
        for (int64_t j = 0; j <= i; j++) {
            const double *b = fit->by_pose + N_FREE * j, *other = spots->lever + j / 2 * 3;
            double levers = lever[1] * other[1] + rate * lever[2] * other[2];
            double shared = linear * dot(a, b) + angular * dot(a + 3, b + 3);
            shared *= lever[0] * other[0] + rate * levers;
            fit->acceleration[n * i + j] = fit->acceleration[n * j + i] = shared;
        }
    }
    for (int64_t s = 0; s < spots->n; s++) {
        int64_t a = 2 * s * (n + 1), b = a + n + 1;
        double variance = fit->noise[a] + fit->acceleration[a];
        variance += fit->noise[b] + fit->acceleration[b];
        fit->uncertainty[s] = sqrt(variance / 2.0);
    }
}

/* Fill in the covariance of the kept coordinates (count, count); `tolerance` (n, n), px^2: what
 * spots may be off beside their noise, none where NULL. */
static void kept_covariance(Kept kept, const Fit *fit, const double *tolerance, double *total)
{
    for (int64_t i = 0; i < kept.count; i++) {
        for (int64_t j = 0; j < kept.count; j++) {
            int64_t at = kept.n * kept.rows[i] + kept.rows[j];
            total[kept.count * i + j] =
                fit->noise[at] + fit->acceleration[at] + (tolerance ? tolerance[at] : 0.0);
        }
    }
}

/* chi^2 of the kept residuals after a step (6,), by their covariance's lower Cholesky factor and
 * their weights in the step (count, 6). */
static double residual_chi2(Kept kept, const Fit *fit, const double *root, const double *weighted,
                            const double *step)
{
    Mark mark = scratch_mark();
    double *off = TAKE(double, kept.count), *solved = TAKE(double, kept.count);
    for (int64_t i = 0; i < kept.count; i++)
        off[i] = solved[i] = fit->residual[kept.rows[i]];
    solve((int)kept.count, root, solved);
    for (int64_t i = 0; i < kept.count; i++)
        solved[i] -= sum_products(N_FREE, weighted + N_FREE * i, step);
    double chi2 = sum_products(kept.count, off, solved);
    scratch_release(mark);
    return chi2;
}

/* Fill in the covariance of the pose (6, 6) by that of n coordinates (n, n). */
static void pose_covariance(int64_t n, const double *gain, const double *source, double *covariance)
{
    Mark mark = scratch_mark();
    double *half = TAKE(double, n);
    for (int i = 0; i < N_FREE; i++) {
        for (int64_t row = 0; row < n; row++)
            half[row] = sum_products(n, source + n * row, gain + n * i);
        for (int j = 0; j < N_FREE; j++)
            covariance[N_FREE * i + j] = sum_products(n, half, gain + n * j);
    }
    scratch_release(mark);
}

/* Find the next step (6,) by the kept residuals, whose covariance has the factor `root`; fill in
 * the covariance (6, 6) of the pose and the kept spots' weights in it (count, 6): C^-1 D. False
 * where it is not finite. */
static bool find_step(Kept kept, const Fit *fit, const double *root, double *inverse,
                      double *weighted, double *step)
{
    double information[N_FREE * N_FREE] = {0.0}, pull[N_FREE] = {0.0};
    for (int64_t r = 0; r < kept.count; r++)
        copy(weighted + N_FREE * r, fit->by_pose + N_FREE * kept.rows[r], N_FREE);
    solve_each((int)kept.count, N_FREE, root, weighted);
    for (int64_t r = 0; r < kept.count; r++) {
        const double *design = fit->by_pose + N_FREE * kept.rows[r];
        for (int i = 0; i < N_FREE; i++) {
            double weight = weighted[N_FREE * r + i];
            pull[i] += weight * fit->residual[kept.rows[r]];
            for (int j = 0; j < N_FREE; j++)
                information[N_FREE * i + j] += weight * design[j];
        }
    }
    bool finite = covariance_of(information, inverse, fit->directions, fit->known);
    for (int i = 0; finite && i < N_FREE; i++)
        step[i] = sum_products(N_FREE, inverse + N_FREE * i, pull);
    return finite;
}

/* Fit a pose (4, 4), rig_T_flange, to spots by Gauss-Newton; it is changed. False where a step is
 * not finite. */
static bool fit_spots(const Spots *spots, Kept kept, double *pose, const Fit *fit)
{
    Mark mark = scratch_mark();
    int64_t n = kept.n, size = kept.count * kept.count;
    double *total = TAKE(double, size), *root = TAKE(double, size);
    double *weighted = TAKE(double, N_FREE * kept.count);
    double inverse[N_FREE * N_FREE], step[N_FREE] = {0.0}, largest = INFINITY;
    bool straight = false, finite = true;
    for (int64_t s = 0; s < spots->n; s++)
        straight = straight || spots->lever[3 * s] != 0.0;
    clear(fit->curvature, n);
    for (int round = 0; round < MAX_ITERATIONS && finite && !(largest < TOL_STEP); round++) {
        predict_spots(pose, spots, fit->residual, fit->by_point, fit->by_pose);
        /* velocities and their lever change nothing measurable in later rounds */
        if (round == 0 || (round == 1 && straight)) {
            twist_from_velocities(spots, kept, fit);
            spot_covariance(spots, fit);
            kept_covariance(kept, fit, NULL, total);
            factor((int)kept.count, total, 0.0, root);
            if (straight)
                image_acceleration(spots, pose, fit);
        }
        for (int64_t i = 0; i < n; i++)
            fit->residual[i] = spots->centre[i] - spots->lever[3 * (i / 2)] * fit->curvature[i]
                - fit->residual[i];
        finite = find_step(kept, fit, root, inverse, weighted, step);
        largest = 0.0;
        for (int i = 0; finite && i < N_FREE; i++)
            largest = MAX(largest, fabs(step[i]));
        if (finite)
            move_pose(pose, step);
    }
    clear(fit->gain, N_FREE * n);
    for (int64_t r = 0; finite && r < kept.count; r++)
        for (int i = 0; i < N_FREE; i++)
            fit->gain[n * i + kept.rows[r]] =
                sum_products(N_FREE, inverse + N_FREE * i, weighted + N_FREE * r);
    pose_covariance(n, fit->gain, fit->noise, fit->covariances);
    pose_covariance(n, fit->gain, fit->acceleration, fit->covariances + N_FREE * N_FREE);
    fit->figures[2] = residual_chi2(kept, fit, root, weighted, step);
    scratch_release(mark);
    return finite;
}

/* Squared residual of a spot in its own uncertainty; `first` of the kept coordinates is its x, and
 * `total` (count, count), px^2, their covariance. */
static double spot_chi2(int64_t first, Kept kept, const Fit *fit, const double *total)
{
    Mark mark = scratch_mark();
    int64_t count = kept.count;
    double *hat = TAKE(double, 2 * count); /* d residual / d spots, (2, count) */
    double xx = MIN_VARIANCE, xy = 0.0, yy = MIN_VARIANCE;
    for (int axis = 0; axis < 2; axis++) {
        const double *design = fit->by_pose + N_FREE * kept.rows[first + axis];
        double *own = hat + count * axis;
        clear(own, count);
        own[first + axis] = 1.0;
        for (int k = 0; k < N_FREE; k++)
            for (int64_t i = 0; i < count; i++)
                own[i] -= design[k] * fit->gain[kept.n * k + kept.rows[i]];
    }
    for (int64_t i = 0; i < count; i++) {
        double x = sum_products(count, total + count * i, hat);
        double y = sum_products(count, total + count * i, hat + count);
        xx += x * hat[i];
        xy += x * hat[count + i];
        yy += y * hat[count + i];
    }
    scratch_release(mark);
    const double *off = fit->residual + kept.rows[first];
    return chi2_of(off[0], off[1], xx, xy, yy);
}

/* Find the kept spot that fits worst, and say whether the kept ones agree as a whole: twice the
 * spot, and one more if they do.
 *
 * `bounds` (2 n + 1,): the greatest chi^2 that noise, motion and tolerance reach, by degrees of
 * freedom. `most`: the worst spot's residual in its own uncertainty, squared. */
static int64_t judge_fit(Kept kept, const Fit *fit, const double *tolerance, const double *bounds,
                         double *most)
{
    Mark mark = scratch_mark();
    int64_t size = kept.count * kept.count, worst = 0, freedom = kept.count;
    double *total = TAKE(double, size), *root = TAKE(double, size), chi2 = fit->figures[2];
    double *weighted = TAKE(double, N_FREE * kept.count), step[N_FREE] = {0.0};
    double inverse[N_FREE * N_FREE], directions[N_FREE * N_FREE];
    bool known[N_FREE];
    kept_covariance(kept, fit, tolerance, total);
    *most = -INFINITY;
    for (int64_t first = 0; first + 1 < kept.count; first += 2) {
        double own = spot_chi2(first, kept, fit, total);
        if (own > *most) {
            worst = kept.rows[first] / 2;
            *most = own;
        }
    }
    for (int i = 0; i < N_FREE; i++)
        freedom -= fit->known[i];
    double most_chi2 = bounds[MAX(freedom, 0)];
    if (!(chi2 < most_chi2)) { /* the tolerance explains more, at the pose that it makes likeliest */
        Fit other = *fit;
        other.directions = directions;
        other.known = known;
        factor((int)kept.count, total, 0.0, root);
        find_step(kept, &other, root, inverse, weighted, step);
        chi2 = residual_chi2(kept, fit, root, weighted, step);
    }
    scratch_release(mark);
    return 2 * worst + (chi2 < most_chi2);
}

/* Fit and judge; gives 0 where the fit is not finite, else one more than the judgement. */
static int64_t fit_and_judge(const Spots *spots, Kept kept, const double *tolerance,
                             const double *bounds, double *pose, const Fit *fit)
{
    bool finite = fit_spots(spots, kept, pose, fit);
    return finite ? 1 + judge_fit(kept, fit, tolerance, bounds, fit->figures + 3) : 0;
}

int64_t entry_predict_spots(int64_t n, int64_t n_left, const double *pose, const double *points,
                            const double *cameras, double *pixels, double *by_point,
                            double *by_pose)
{
    Spots spots = {.n = n, .n_left = n_left, .points = points, .cameras = cameras};
    predict_spots(pose, &spots, pixels, by_point, by_pose);
    return 0;
}

int64_t entry_move_pose(double *pose, const double *step)
{
    move_pose(pose, step);
    return 0;
}

/* Arguments as in `Spots`, `Fit` and `judge_fit`; `spread` (2, 2 n, 2 n): noise, acceleration;
 * `figures` (4,): those of the fit, and the judgement's `most`. */
int64_t entry_fit_spots(int64_t n, int64_t n_left, const double *points, const double *cameras,
                        const double *centre, const double *covariance, const double *velocity,
                        const double *lever, int64_t count, const int64_t *rows,
                        const double *tolerance, const double *bounds, double *pose,
                        double *residual, double *by_point, double *by_pose, double *spread,
                        double *gain, double *directions, bool *known, double *twist,
                        double *curvature, double *covariances, double *uncertainty,
                        double *figures)
{
    Spots spots = {n, n_left, points, cameras, centre, covariance, velocity, lever};
    Fit fit = {residual, by_point, by_pose, spread, spread + 4 * n * n, gain, directions, known,
               twist, curvature, covariances, uncertainty, figures};
    GUARDED(fit_and_judge(&spots, (Kept){2 * n, count, rows}, tolerance, bounds, pose, &fit));
}
