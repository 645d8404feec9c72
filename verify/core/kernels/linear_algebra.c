#include "linear_algebra.h"
#include "scratch.h"

double select_rank(const double *values, int64_t n, int64_t rank)
{
    Mark mark = scratch_mark();
    double *rest = TAKE(double, n);
    copy(rest, values, n);
    int64_t low = 0, high = n - 1;
    while (low < high) { /* Hoare's quickselect */
        double pivot = rest[(low + high) / 2];
        int64_t i = low, j = high;
        while (i <= j) {
            while (rest[i] < pivot)
                i++;
            while (pivot < rest[j])
                j--;
            if (i <= j) {
                double held = rest[i];
                rest[i++] = rest[j];
                rest[j--] = held;
            }
        }
        if (rank <= j)
            high = j;
        else if (rank >= i)
            low = i;
        else
            break;
    }
    double found = rest[rank];
    scratch_release(mark);
    return found;
}

double median(const double *values, int64_t n)
{
    if (n % 2)
        return select_rank(values, n, n / 2);
    return (select_rank(values, n, n / 2 - 1) + select_rank(values, n, n / 2)) / 2.0;
}

int64_t first_by(const double *values, int64_t n, int64_t *index, int64_t most)
{
    for (int64_t k = 0; k < n; k++) {
        int64_t one = index[k], at = k;
        for (; at > 0 && values[one] < values[index[at - 1]]; at--)
            index[at] = index[at - 1];
        index[at] = one;
    }
    return MIN(n, most);
}

/* Angle (rad) and distance (m) of the motion between two poses (4, 4). */
static void motion_between(const double *one, const double *other, double *angle, double *away)
{
    double turn = 0.0;
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++)
            turn += square(one[4 * i + j] - other[4 * i + j]);
    double x = one[3] - other[3], y = one[7] - other[7], z = one[11] - other[11];
    /* the norm of two rotations' difference is sqrt(8) times the sine of half the angle */
    double sine = sqrt(turn / 8.0);
    *angle = 2.0 * asin(MIN(sine, 1.0));
    *away = sqrt(x * x + y * y + z * z);
}

/* Fill in `cost` (o,): mean squared misfit of the motions read to those measured, at o offsets.
 *
 * `ends` (o, 2, n): which of the flange's poses read (., 4, 4) begins and ends each of n
 * motions; `known` (o, n): those with readings. `figures`, the motions' angle and distance, and
 * `variance` of each, (n, 2). A squared misfit counts for `most` at most: a wild pair has one
 * vote. */
int64_t entry_motion_misfits(int64_t o, int64_t n, const int64_t *ends, const bool *known,
                             const double *poses, const double *figures, const double *variance,
                             double most, double *cost)
{
    for (int64_t row = 0; row < o; row++) {
        const int64_t *first = ends + 2 * n * row, *last = first + n;
        double total = 0.0;
        int64_t count = 0;
        for (int64_t i = 0; i < n; i++) {
            if (!known[n * row + i])
                continue;
            double motion[2];
            motion_between(poses + 16 * first[i], poses + 16 * last[i], motion, motion + 1);
            for (int k = 0; k < 2; k++) {
                double misfit = square(motion[k] - figures[2 * i + k]) / variance[2 * i + k];
                total += MIN(misfit, most);
            }
            count += 2;
        }
        cost[row] = total / (double)count;
    }
    return 0;
}

/* Fill in angle (rad) and distance (m) of the motions between n pairs of poses (n, 4, 4): (n,
 * 2). */
int64_t entry_motion_sizes(int64_t n, const double *one, const double *other, double *figures)
{
    for (int64_t i = 0; i < n; i++)
        motion_between(one + 16 * i, other + 16 * i, figures + 2 * i, figures + 2 * i + 1);
    return 0;
}

/* Fill in rotation vectors (n, 3), rad, of turns (n, 3, 3), by quaternion (Shepperd, 1978). */
int64_t entry_rotation_vectors(int64_t n, const double *turns, double *vectors)
{
    for (int64_t row = 0; row < n; row++) {
        const double *m = turns + 9 * row;
        double q[4], trace = m[0] + m[4] + m[8]; /* x, y, z, w */
        int i = 3;
        for (int j = 0; j < 3; j++)
            if (m[4 * j] > (i == 3 ? trace : m[4 * i]))
                i = j;
        if (i == 3) {
            q[0] = m[7] - m[5];
            q[1] = m[2] - m[6];
            q[2] = m[3] - m[1];
            q[3] = 1.0 + trace;
        } else {
            int j = (i + 1) % 3, k = (i + 2) % 3;
            q[i] = 1.0 + m[4 * i] - m[4 * j] - m[4 * k];
            q[j] = m[3 * j + i] + m[3 * i + j];
            q[k] = m[3 * k + i] + m[3 * i + k];
            q[3] = m[3 * k + j] - m[3 * j + k];
        }
        double size = sqrt(dot(q, q)), sign = q[3] < 0.0 ? -1.0 : 1.0; /* the shorter way round */
        double scale = size > 0.0 ? sign * 2.0 * atan2(size, sign * q[3]) / size : 0.0;
        for (i = 0; i < 3; i++)
            vectors[3 * row + i] = scale * q[i];
    }
    return 0;
}

int64_t entry_factor(int64_t n, const double *matrix, double less, double *root)
{
    return factor((int)n, matrix, less, root);
}

int64_t entry_solve_each(int64_t n, int64_t m, const double *root, double *right)
{
    solve_each((int)n, (int)m, root, right);
    return 0;
}

int64_t entry_solve(int64_t n, const double *root, double *right)
{
    solve((int)n, root, right);
    return 0;
}

int64_t entry_invert(int64_t n, const double *root, double *inverse)
{
    invert((int)n, root, inverse);
    return 0;
}
