/* Predict the spots of a pose, and fit a pose to spots by Gauss-Newton.
 *
 * With z the spots of both images, u(T) their prediction, D its derivative by the pose, C the
 * spots' covariance from pixels and a from an unknown acceleration, each step is
 *
 *     (D' (C + a)^-1 D)^-1 D' (C + a)^-1 (z - u(T))
 *
 * restricted to the directions that the spots determine.
 */
#include "verify/core/kernels/linear_algebra.h"
#include "verify/core/kernels/scratch.h"

#define N_FREE 6
#define LEVER 0.1 /* m, the size of a marker: makes metres and radians comparable */
/* LEDs nearly on a line: a turn less certain than this is no measurement, and too large for the
 * linearisation that its uncertainty rests on. */
#define MAX_UNCERTAINTY 0.1 /* rad, or 10 mm at the marker's size */
#define MIN_INFORMATION 1e-10 /* of a direction, relative to the best: rounding, not measurement */
#define MAX_ITERATIONS 25
#define MAX_SWEEPS 50 /* of Jacobi's rotations; eight do */
#define NEGLIGIBLE 1e-17 /* off the diagonal, of the largest entry */
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

/* m and rad: units in which both are alike */
static const double SCALE[N_FREE] = {LEVER, LEVER, LEVER, 1.0, 1.0, 1.0};

typedef struct { /* n spots */
    int64_t n;
    const double *points; /* (n, 3), m, LEDs in the flange frame */
    const double *camera_R_rig; /* (n, 3, 3), of each spot's camera */
    const double *origin; /* (n, 3), m, of the rig in the camera */
    const double *lens; /* (5, n), k1, k2, p1, p2, k3 */
    const double *focal; /* (n, 2, 2), px */
    const double *middle; /* (n, 2), px, principal points */
    const double *centre; /* (n, 2), px, as measured; not for a prediction, nor what follows */
    const double *covariance; /* (n, 2, 2), px^2 */
    const double *velocity; /* (n, 2), px/s */
    const double *lever; /* (n, 3), s^2, s^3, s^4, of acceleration, jerk and snap */
} Spots;

typedef struct { /* a pose's fit to n spots */
    double *residual; /* (n, 2), px, before the last step, as are the derivatives */
    double *by_point; /* (n, 2, 3), px/m, of the spots by the point in the rig */
    double *by_pose; /* (n, 2, 6), by a translation and a rotation vector in rig axes */
    double *noise; /* (2 n, 2 n), px^2, covariance of the spots from the pixels */
    double *acceleration; /* (2 n, 2 n), from motion that is not known */
    double *weight; /* (2 n, 2 n), inverse of their sum: that of the kept spots, 0 for others */
    double *gain; /* (6, 2 n), d pose / d spot, 0 for spots that do not count */
    double *directions; /* (6, 6), of `covariance_of` */
    bool *known; /* (6,) */
    double *twist; /* (6,), m/s and rad/s */
    double *curvature; /* (n, 2), px/s^2, image acceleration of the twist, corrected for */
    double *pixels; /* (6, 6), covariance of the pose by the pixels' noise */
    double *alignment; /* (6, 6), by motion that is not known */
    double *uncertainty; /* (n,), px, of a spot in a coordinate, by both */
    double *figures; /* acceleration assumed, a component, m/s^2 and rad/s^2; chi^2 of residuals */
} Fit;

static void clear(double *values, int64_t n)
{
    memset(values, 0, sizeof(double) * (size_t)n);
}

static void add_times(int64_t n, double factor, const double *restrict row, double *restrict sum)
{
#pragma omp simd
    for (int64_t i = 0; i < n; i++)
        sum[i] += factor * row[i];
}

/* Fill in the spots' images (n, 2) at a pose (4, 4), and how they change with point and pose. */
static void predict_spots(const double *pose, const Spots *at, double *pixels, double *by_point,
                          double *by_pose)
{
    int64_t n = at->n;
    for (int64_t s = 0; s < n; s++) {
        const double *point = at->points + 3 * s, *turn = at->camera_R_rig + 9 * s;
        const double *origin = at->origin + 3 * s, *lens = at->lens + s;
        double a = dot(pose, point), b = dot(pose + 4, point), c = dot(pose + 8, point);
        double placed[3] = {a + pose[3], b + pose[7], c + pose[11]};
        double depth = dot(turn + 6, placed) + origin[2];
        double x = (dot(turn, placed) + origin[0]) / depth;
        double y = (dot(turn + 3, placed) + origin[1]) / depth;
        double k1 = lens[0], k2 = lens[n], p1 = lens[2 * n], p2 = lens[3 * n], k3 = lens[4 * n];
        double r2 = x * x + y * y, higher = r2 * k3 + k2;
        double radial = 1.0 + r2 * (k1 + r2 * higher);
        double slope = 2.0 * (k1 + r2 * (higher + higher + r2 * k3)); /* 2 d radial / d r2 */
        double straight = radial + 2.0 * (p1 * y + p2 * x);
        double distorted_x = x * straight + p2 * r2, distorted_y = y * straight + p1 * r2;
        double xx = straight + x * x * slope + 4.0 * p2 * x;
        double xy = x * y * slope + 2.0 * (p1 * x + p2 * y);
        double yy = straight + y * y * slope + 4.0 * p1 * y;
        for (int i = 0; i < 2; i++) {
            int64_t row = 2 * s + i;
            double f = at->focal[2 * row], g = at->focal[2 * row + 1];
            pixels[row] = f * distorted_x + g * distorted_y + at->middle[row];
            double by_x = (f * xx + g * xy) / depth, by_y = (f * xy + g * yy) / depth;
            double by_depth = -(by_x * x + by_y * y);
            double d = by_x * turn[0] + by_y * turn[3] + by_depth * turn[6];
            double e = by_x * turn[1] + by_y * turn[4] + by_depth * turn[7];
            double h = by_x * turn[2] + by_y * turn[5] + by_depth * turn[8];
            double all[N_FREE] = {d, e, h, h * b - e * c, d * c - h * a, e * a - d * b};
            copy(by_point + 3 * row, all, 3);
            copy(by_pose + N_FREE * row, all, N_FREE);
        }
    }
}

/* Move a pose (4, 4) in place by translation and rotation vector (6,). */
static void move_pose(double *pose, const double *step)
{
    rotate(pose, 4, step + 3);
    for (int j = 0; j < 3; j++)
        pose[4 * j + 3] += step[j];
}

/* Add the image acceleration of the spots (n, 2), px/s^2, at a pose under a steady twist (6,).
 *
 * LEDs that turn about the flange, and points that come nearer, do not cross the image at a steady
 * rate even then. It points one way, so it would not average out. */
static void image_acceleration(const Spots *spots, const double *pose, const double *twist,
                               double *second)
{
    Mark mark = scratch_mark();
    int64_t n = spots->n;
    double *pixels = TAKE(double, 2 * n), *by_point = TAKE(double, 6 * n);
    double *by_pose = TAKE(double, 2 * N_FREE * n);
    for (int h = -1; h <= 1; h++) {
        double moved[16], step[N_FREE];
        copy(moved, pose, 16);
        for (int i = 0; i < N_FREE; i++)
            step[i] = twist[i] * (h * TIME_STEP);
        move_pose(moved, step);
        predict_spots(moved, spots, pixels, by_point, by_pose);
        add_times(2 * n, (h ? 1.0 : -2.0) / square(TIME_STEP), pixels, second);
    }
    scratch_release(mark);
}

/* Fill in eigenvectors, as columns (6, 6), of a symmetric matrix (6, 6), whose diagonal becomes the
 * eigenvalues, in any order.
 *
 * Source: Jacobi's rotations, row by row. */
static void find_directions(double *matrix, double *vectors)
{
    double largest = 0.0;
    for (int i = 0; i < N_FREE * N_FREE; i++) {
        vectors[i] = i % (N_FREE + 1) ? 0.0 : 1.0;
        largest = MAX(largest, fabs(matrix[i]));
    }
    bool rotated = true;
    for (int sweep = 0; sweep < MAX_SWEEPS && rotated; sweep++) {
        rotated = false;
        for (int p = 0; p < N_FREE; p++) {
            for (int q = p + 1; q < N_FREE; q++) {
                double off = matrix[p * N_FREE + q];
                if (!(fabs(off) > NEGLIGIBLE * largest))
                    continue;
                rotated = true;
                double half = (matrix[q * N_FREE + q] - matrix[p * N_FREE + p]) / (2.0 * off);
                double t = copysign(1.0, half) / (fabs(half) + sqrt(half * half + 1.0));
                double cosine = 1.0 / sqrt(t * t + 1.0), sine = t * cosine;
                for (int k = 0; k < N_FREE; k++) {
                    double *a = matrix + k * N_FREE, *v = vectors + k * N_FREE, held = a[p];
                    a[p] = cosine * held - sine * a[q];
                    a[q] = sine * held + cosine * a[q];
                    held = v[p];
                    v[p] = cosine * held - sine * v[q];
                    v[q] = sine * held + cosine * v[q];
                }
                for (int k = 0; k < N_FREE; k++) {
                    double *a = matrix + k, held = a[p * N_FREE];
                    a[p * N_FREE] = cosine * held - sine * a[q * N_FREE];
                    a[q * N_FREE] = sine * held + cosine * a[q * N_FREE];
                }
            }
        }
    }
}

/* Fill in the covariance (6, 6) in the directions that an information matrix (6, 6), 1/m^2 and
 * 1/rad^2, determines: that of one or two LEDs (or of LEDs on one line) is singular; its null
 * vectors are the motions that no picture shows. Filled too: `vectors` (6, 6), columns, directions
 * in units of SCALE, in any order, only where one of them is not known; `known` (6,). False where
 * the matrix is not finite. */
static bool covariance_of(const double *information, double *inverse, double *vectors, bool *known)
{
    double scaled[N_FREE * N_FREE], root[N_FREE * N_FREE], trace = 0.0;
    for (int i = 0; i < N_FREE; i++) {
        for (int j = 0; j < N_FREE; j++)
            scaled[i * N_FREE + j] = information[i * N_FREE + j] * SCALE[i] * SCALE[j];
        trace += scaled[i * N_FREE + i];
        known[i] = true;
    }
    double least = 1.0 / square(MAX_UNCERTAINTY);
    /* no eigenvalue is so small: the usual case, decided without the eigenvalues */
    if (factor(N_FREE, scaled, MAX(MIN_INFORMATION * trace, least), root)) {
        factor(N_FREE, scaled, 0.0, root);
        invert(N_FREE, root, inverse);
    } else {
        for (int i = 0; i < N_FREE * N_FREE; i++)
            if (!isfinite(scaled[i]))
                return false;
        find_directions(scaled, vectors);
        clear(inverse, N_FREE * N_FREE);
        double best = 0.0;
        for (int k = 0; k < N_FREE; k++)
            best = MAX(best, scaled[k * N_FREE + k]);
        for (int k = 0; k < N_FREE; k++) {
            double value = scaled[k * N_FREE + k];
            known[k] = value > MAX(MIN_INFORMATION * best, least);
            for (int i = 0; known[k] && i < N_FREE; i++)
                for (int j = 0; j < N_FREE; j++)
                    inverse[i * N_FREE + j] +=
                        vectors[i * N_FREE + k] * vectors[j * N_FREE + k] / value;
        }
    }
    for (int i = 0; i < N_FREE; i++)
        for (int j = 0; j < N_FREE; j++)
            inverse[i * N_FREE + j] *= SCALE[i] * SCALE[j];
    return true;
}

/* Fill in how the flange moves, `twist` (6,), from the spots' velocities, and the acceleration
 * that this suggests, a component, m/s^2 and rad/s^2.
 *
 * Clean spots count alike, doubtful ones hardly; of the coordinates, those of kept spots,
 * `rows`. */
static void twist_from_velocities(const Spots *spots, const double *design, int64_t count,
                                  const int64_t *rows, double *twist, double *prior)
{
    double information[N_FREE * N_FREE] = {0.0}, root[N_FREE * N_FREE], trace = 0.0;
    bool moving = false;
    prior[0] = MIN_LINEAR;
    prior[1] = MIN_ANGULAR;
    clear(twist, N_FREE);
    for (int64_t i = 0; i < count; i++)
        moving = moving || spots->velocity[rows[i]] != 0.0;
    if (!moving)
        return;
    for (int64_t r = 0; r < count; r++) {
        int64_t row = rows[r];
        const double *by_pose = design + N_FREE * row;
        double variance = spots->covariance[2 * row + row % 2];
        double share = square(CLEAN_PX) / (square(CLEAN_PX) + variance);
        for (int i = 0; i < N_FREE; i++) {
            double scaled = share * by_pose[i] * SCALE[i];
            twist[i] += scaled * spots->velocity[row];
            for (int j = 0; j < N_FREE; j++)
                information[i * N_FREE + j] += scaled * by_pose[j] * SCALE[j];
            trace += scaled * by_pose[i] * SCALE[i];
        }
    }
    factor(N_FREE, information, -RIDGE * trace / N_FREE, root);
    solve(N_FREE, root, twist);
    for (int i = 0; i < N_FREE; i++)
        twist[i] *= SCALE[i];
    for (int part = 0; part < 2; part++) {
        double speed = sqrt(dot(twist + 3 * part, twist + 3 * part));
        prior[part] = (prior[part] + ACCELERATION_PER_SPEED * speed) / sqrt(3.0);
    }
}

/* Fill in the inverse (n, n) of a covariance by its lower Cholesky factor (n, n): the half below
 * the diagonal, which is then mirrored. A third of `invert`'s work. */
static void invert_covariance(int64_t n, const double *root, double *inverse)
{
    clear(inverse, n * n);
    for (int64_t i = 0; i < n; i++) {
        double *row = inverse + n * i;
        row[i] = 1.0;
        for (int64_t k = 0; k < i; k++)
            add_times(k + 1, -root[n * i + k], inverse + n * k, row);
        for (int64_t c = 0; c <= i; c++)
            row[c] /= root[n * i + i];
    }
    for (int64_t i = n - 1; i >= 0; i--) {
        double *row = inverse + n * i;
        for (int64_t k = i + 1; k < n; k++)
            add_times(i + 1, -root[n * k + i], inverse + n * k, row);
        for (int64_t c = 0; c <= i; c++) {
            row[c] /= root[n * i + i];
            inverse[n * c + i] = row[c];
        }
    }
}

/* Fill in the covariance of the spots by its sources, and its inverse. */
static void spot_covariance(const Spots *spots, int64_t count, const int64_t *rows, const Fit *fit)
{
    Mark mark = scratch_mark();
    int64_t n = 2 * spots->n;
    double *moved = TAKE(double, N_FREE * n), *levers = TAKE(double, 3 * spots->n);
    double *kept = TAKE(double, count * count), *root = TAKE(double, count * count);
    clear(fit->noise, n * n);
    clear(fit->weight, n * n);
    for (int64_t i = 0; i < n; i++) {
        copy(fit->noise + n * i + i / 2 * 2, spots->covariance + 2 * i, 2);
        for (int k = 0; k < N_FREE; k++)
            moved[N_FREE * i + k] = fit->figures[k / 3] * fit->by_pose[N_FREE * i + k];
    }
    for (int64_t s = 0; s < spots->n; s++) {
        levers[3 * s] = spots->lever[3 * s];
        levers[3 * s + 1] = spots->lever[3 * s + 1] * MOTION_RATE;
        levers[3 * s + 2] = spots->lever[3 * s + 2] * square(MOTION_RATE);
    }
    for (int64_t i = 0; i < n; i++) {
        for (int64_t j = 0; j <= i; j++) {
            const double *a = moved + N_FREE * i, *b = moved + N_FREE * j;
            double shared = dot(a, b) + dot(a + 3, b + 3);
            shared *= dot(levers + 3 * (i / 2), levers + 3 * (j / 2));
            fit->acceleration[n * i + j] = fit->acceleration[n * j + i] = shared;
        }
    }
    for (int64_t i = 0; i < count; i++) {
        for (int64_t j = 0; j < count; j++) {
            int64_t at = n * rows[i] + rows[j];
            kept[count * i + j] = fit->noise[at] + fit->acceleration[at];
        }
    }
    factor((int)count, kept, 0.0, root);
    invert_covariance(count, root, kept);
    for (int64_t i = 0; i < count; i++)
        for (int64_t j = 0; j < count; j++)
            fit->weight[n * rows[i] + rows[j]] = kept[count * i + j];
    scratch_release(mark);
}

/* Fill in what n coordinates weigh in the pose (6, n), and its information (6, 6). */
static void pose_information(int64_t n, const Fit *fit, double *weighted, double *information)
{
    clear(weighted, N_FREE * n);
    clear(information, N_FREE * N_FREE);
    for (int64_t row = 0; row < n; row++)
        for (int i = 0; i < N_FREE; i++)
            add_times(n, fit->by_pose[N_FREE * row + i], fit->weight + n * row, weighted + n * i);
    for (int i = 0; i < N_FREE; i++)
        for (int64_t column = 0; column < n; column++)
            for (int j = 0; j < N_FREE; j++)
                information[N_FREE * i + j] +=
                    weighted[n * i + column] * fit->by_pose[N_FREE * column + j];
}

/* Fill in the covariance of the pose (6, 6) by that of n coordinates (n, n). */
static void pose_covariance(int64_t n, const double *gain, const double *source, double *covariance)
{
    Mark mark = scratch_mark();
    double *half = TAKE(double, n);
    for (int i = 0; i < N_FREE; i++) {
        clear(half, n);
        for (int64_t row = 0; row < n; row++)
            add_times(n, gain[n * i + row], source + n * row, half);
        for (int j = 0; j < N_FREE; j++) {
            double sum = 0.0;
#pragma omp simd reduction(+ : sum)
            for (int64_t column = 0; column < n; column++)
                sum += half[column] * gain[n * j + column];
            covariance[N_FREE * i + j] = sum;
        }
    }
    scratch_release(mark);
}

/* Fill in the pose's covariances, the spots' uncertainty, and the residuals' chi^2. */
static void fit_covariances(int64_t n, const Fit *fit)
{
    double chi2 = 0.0;
    pose_covariance(n, fit->gain, fit->noise, fit->pixels);
    pose_covariance(n, fit->gain, fit->acceleration, fit->alignment);
    for (int64_t row = 0; row < n; row++) {
        double sum = 0.0;
#pragma omp simd reduction(+ : sum)
        for (int64_t column = 0; column < n; column++)
            sum += fit->weight[n * row + column] * fit->residual[column];
        chi2 += fit->residual[row] * sum;
    }
    for (int64_t s = 0; s < n / 2; s++) {
        int64_t a = 2 * s * (n + 1), b = a + n + 1;
        double variance = fit->noise[a] + fit->acceleration[a];
        variance += fit->noise[b] + fit->acceleration[b];
        fit->uncertainty[s] = sqrt(variance / 2.0);
    }
    fit->figures[2] = chi2;
}

/* Fit a pose (4, 4), rig_T_flange, to spots by Gauss-Newton; it is changed. `rows` (count,): the
 * coordinates of spots that count. False where a step is not finite. */
static bool fit_spots(const Spots *spots, int64_t count, const int64_t *rows, double *pose,
                      const Fit *fit)
{
    Mark mark = scratch_mark();
    int64_t n = 2 * spots->n;
    double *weighted = TAKE(double, N_FREE * n), step[N_FREE];
    double information[N_FREE * N_FREE], inverse[N_FREE * N_FREE];
    bool straight = false, finite = true;
    for (int64_t s = 0; s < spots->n; s++)
        straight = straight || spots->lever[3 * s] != 0.0;
    clear(fit->curvature, n);
    for (int iteration = 0; iteration < MAX_ITERATIONS; iteration++) {
        predict_spots(pose, spots, fit->residual, fit->by_point, fit->by_pose);
        /* velocities and their lever change nothing measurable in later rounds */
        if (iteration == 0 || (iteration == 1 && straight)) {
            twist_from_velocities(spots, fit->by_pose, count, rows, fit->twist, fit->figures);
            spot_covariance(spots, count, rows, fit);
            if (straight) {
                clear(fit->curvature, n);
                image_acceleration(spots, pose, fit->twist, fit->curvature);
            }
        }
        for (int64_t i = 0; i < n; i++) {
            double measured = spots->centre[i] - spots->lever[3 * (i / 2)] * fit->curvature[i];
            fit->residual[i] = measured - fit->residual[i];
        }
        pose_information(n, fit, weighted, information);
        finite = covariance_of(information, inverse, fit->directions, fit->known);
        if (!finite)
            break;
        double largest = 0.0;
        clear(fit->gain, N_FREE * n);
        for (int i = 0; i < N_FREE; i++) {
            double *gain = fit->gain + n * i, sum = 0.0;
            for (int j = 0; j < N_FREE; j++)
                add_times(n, inverse[N_FREE * i + j], weighted + n * j, gain);
#pragma omp simd reduction(+ : sum)
            for (int64_t column = 0; column < n; column++)
                sum += gain[column] * fit->residual[column];
            step[i] = sum;
            largest = MAX(largest, fabs(sum));
        }
        move_pose(pose, step);
        if (largest < TOL_STEP)
            break;
    }
    if (finite)
        fit_covariances(n, fit);
    scratch_release(mark);
    return finite;
}

/* Squared residual of a spot in its own uncertainty; `first` of the kept coordinates is its x.
 * `total` (count, count), px^2: covariance of the kept coordinates, whose residuals are `off`. */
static double spot_chi2(int64_t first, int64_t count, const int64_t *rows, int64_t n,
                        const double *by_pose, const double *gain, const double *total,
                        const double *off)
{
    Mark mark = scratch_mark();
    double *hat = TAKE(double, 2 * count), *half = TAKE(double, 2 * count), block[4] = {0.0};
    clear(half, 2 * count);
    for (int axis = 0; axis < 2; axis++) {
        const double *design = by_pose + N_FREE * rows[first + axis];
        double *own = hat + count * axis;
        for (int64_t i = 0; i < count; i++) {
            own[i] = i == first + axis ? 1.0 : 0.0;
            for (int k = 0; k < N_FREE; k++)
                own[i] -= design[k] * gain[n * k + rows[i]];
        }
        for (int64_t i = 0; i < count; i++)
            add_times(count, own[i], total + count * i, half + count * axis);
    }
    for (int64_t i = 0; i < count; i++)
        for (int k = 0; k < 4; k++)
            block[k] += half[count * (k / 2) + i] * hat[count * (k % 2) + i];
    scratch_release(mark);
    double a = block[0] + MIN_VARIANCE, d = block[3] + MIN_VARIANCE;
    double x = off[first], y = off[first + 1], across = (block[1] + block[2]) * x * y;
    return (d * x * x - across + a * y * y) / (a * d - block[1] * block[2]);
}

/* Find the kept spot that fits worst, and say whether the kept ones agree as a whole: twice the
 * spot, and one more if they do.
 *
 * `tolerance` (2 n, 2 n), px^2: what spots may be off beside their noise; `own`, chi^2 of the
 * residuals; `most_chi2`, the greatest that noise, motion and tolerance reach. `most`: the worst
 * spot's residual in its own uncertainty, squared. */
static int64_t judge_fit(int64_t n, int64_t count, const int64_t *rows, const Fit *fit,
                         const double *tolerance, double own, double most_chi2, double *most)
{
    Mark mark = scratch_mark();
    double *total = TAKE(double, count * count), *root = TAKE(double, count * count);
    double *off = TAKE(double, count), *solved = TAKE(double, count);
    int64_t worst = 0;
    for (int64_t i = 0; i < count; i++) {
        off[i] = fit->residual[rows[i]];
        for (int64_t j = 0; j < count; j++) {
            int64_t at = n * rows[i] + rows[j];
            total[count * i + j] = fit->noise[at] + fit->acceleration[at] + tolerance[at];
        }
    }
    *most = -INFINITY;
    for (int64_t first = 0; first + 1 < count; first += 2) {
        double size = spot_chi2(first, count, rows, n, fit->by_pose, fit->gain, total, off);
        if (size > *most) {
            worst = rows[first] / 2;
            *most = size;
        }
    }
    if (!(own < most_chi2)) {
        copy(solved, off, count);
        factor((int)count, total, 0.0, root);
        solve((int)count, root, solved);
        own = 0.0;
        for (int64_t i = 0; i < count; i++)
            own += off[i] * solved[i];
    }
    scratch_release(mark);
    return 2 * worst + (own < most_chi2);
}

int64_t entry_predict_spots(int64_t n, const double *pose, const double *points,
                            const double *camera_R_rig, const double *origin, const double *lens,
                            const double *focal, const double *middle, double *pixels,
                            double *by_point, double *by_pose)
{
    Spots spots = {n, points, camera_R_rig, origin, lens, focal, middle, NULL, NULL, NULL, NULL};
    predict_spots(pose, &spots, pixels, by_point, by_pose);
    return 0;
}

int64_t entry_move_pose(double *pose, const double *step)
{
    move_pose(pose, step);
    return 0;
}

int64_t entry_covariance_of(const double *information, double *inverse, double *vectors,
                            bool *known)
{
    return covariance_of(information, inverse, vectors, known);
}

/* Arguments as in `Spots` and `Fit`; `spread`: noise, acceleration, weight; `covariances`: pixels,
 * alignment. */
int64_t entry_fit_spots(int64_t n, const double *points, const double *camera_R_rig,
                        const double *origin, const double *lens, const double *focal,
                        const double *middle, const double *centre, const double *covariance,
                        const double *velocity, const double *lever, int64_t count,
                        const int64_t *rows, double *pose, double *residual, double *by_point,
                        double *by_pose, double *spread, double *gain, double *directions,
                        bool *known, double *twist, double *curvature, double *covariances,
                        double *uncertainty, double *figures)
{
    int64_t size = 4 * n * n;
    Spots spots = {n, points, camera_R_rig, origin, lens, focal, middle, centre, covariance,
                   velocity, lever};
    Fit fit = {residual, by_point, by_pose, spread, spread + size, spread + 2 * size, gain,
               directions, known, twist, curvature, covariances, covariances + N_FREE * N_FREE,
               uncertainty, figures};
    GUARDED(fit_spots(&spots, count, rows, pose, &fit));
}

int64_t entry_judge_fit(int64_t n, double *residual, double *by_pose, double *noise,
                        double *acceleration, double *gain, int64_t count, const int64_t *rows,
                        const double *tolerance, double own, double most_chi2, double *most)
{
    Fit fit = {.residual = residual, .by_pose = by_pose, .noise = noise,
               .acceleration = acceleration, .gain = gain};
    GUARDED(judge_fit(2 * n, count, rows, &fit, tolerance, own, most_chi2, most));
}
