/* Small vectors and matrices: products, Cholesky's factor, medians, order, motions.
 *
 * With A = L L', `factor` fills in L, `solve` A^-1 b and `invert` A^-1. Matrices are row by row.
 */
#ifndef VERIFY_LINEAR_ALGEBRA_H
#define VERIFY_LINEAR_ALGEBRA_H

#include <math.h>
#include <stdbool.h>
#include <stdint.h>
#include <string.h>

/* As Python's: of two numbers of which one is no number, the first. */
#define MAX(a, b) ((b) > (a) ? (b) : (a))
#define MIN(a, b) ((b) < (a) ? (b) : (a))

#define SMALL_ANGLE 1e-9 /* rad: below, sine and angle are the same */

static inline double square(double x)
{
    return x * x;
}

/* Scalar product of two vectors (3,). */
static inline double dot(const double *a, const double *b)
{
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

/* Scalar product of two vectors (n,). */
static inline double sum_products(int64_t n, const double *restrict a, const double *restrict b)
{
    double sum = 0.0;
#pragma omp simd reduction(+ : sum)
    for (int64_t i = 0; i < n; i++)
        sum += a[i] * b[i];
    return sum;
}

/* Distance of two points (3,). */
static inline double distance(const double *a, const double *b)
{
    return sqrt(square(a[0] - b[0]) + square(a[1] - b[1]) + square(a[2] - b[2]));
}

/* Fill in the cross product of two vectors (3,). */
static inline void cross(const double *a, const double *b, double *product)
{
    product[0] = a[1] * b[2] - a[2] * b[1];
    product[1] = a[2] * b[0] - a[0] * b[2];
    product[2] = a[0] * b[1] - a[1] * b[0];
}

/* Give a vector (3,) the length one. */
static inline void scale_to_one(double *vector)
{
    double length = sqrt(dot(vector, vector));
    for (int i = 0; i < 3; i++)
        vector[i] /= length;
}

static inline void copy(double *target, const double *source, int64_t n)
{
    memcpy(target, source, sizeof(double) * (size_t)n);
}

static inline void clear(double *values, int64_t n)
{
    memset(values, 0, sizeof(double) * (size_t)n);
}

/* Fill in a point (3,) as a pose places it, by its first three rows (3, 4). */
static inline void place_point(const double *pose, const double *point, double *placed)
{
    for (int i = 0; i < 3; i++)
        placed[i] = dot(pose + 4 * i, point) + pose[4 * i + 3];
}

/* Squared length of (x, y) in its covariance xx, xy, yy. */
static inline double chi2_of(double x, double y, double xx, double xy, double yy)
{
    return (yy * x * x - 2.0 * xy * x * y + xx * y * y) / (xx * yy - xy * xy);
}

/* Rotate the first three columns and rows of a matrix in place by a rotation vector (3,); `width`
 * is its number of columns, 3 or 4. */
static inline void rotate(double *axes, int width, const double *vector)
{
    double x = vector[0], y = vector[1], z = vector[2], angle = sqrt(dot(vector, vector));
    double sine = angle > SMALL_ANGLE ? sin(angle) / angle : 1.0;
    double versine = angle > SMALL_ANGLE ? 0.5 * square(sin(0.5 * angle) / (0.5 * angle)) : 0.5;
    for (int j = 0; j < 3; j++) {
        double a = axes[j], b = axes[width + j], c = axes[2 * width + j];
        /* Rodrigues: v + sine (w x v) + versine (w x (w x v)) */
        double d = y * c - z * b, e = z * a - x * c, f = x * b - y * a;
        axes[j] = a + sine * d + versine * (y * f - z * e);
        axes[width + j] = b + sine * e + versine * (z * d - x * f);
        axes[2 * width + j] = c + sine * f + versine * (x * e - y * d);
    }
}

/* Move a pose (4, 4) in place by translation and rotation vector (6,). */
static inline void move_pose(double *pose, const double *step)
{
    rotate(pose, 4, step + 3);
    for (int j = 0; j < 3; j++)
        pose[4 * j + 3] += step[j];
}

/* Fill in the lower Cholesky factor of a matrix (n, n) with `less` taken off its diagonal; what is
 * above the diagonal of `root` is left alone. False where that is not positive definite; the factor
 * has NaN then. */
static inline bool factor(int n, const double *matrix, double less, double *root)
{
    bool definite = true;
    for (int i = 0; i < n; i++) {
        for (int j = 0; j <= i; j++) {
            double rest = matrix[i * n + j] - (i == j ? less : 0.0);
            for (int k = 0; k < j; k++)
                rest -= root[i * n + k] * root[j * n + k];
            if (i > j) {
                root[i * n + j] = rest / root[j * n + j];
            } else {
                definite = definite && rest > 0.0;
                root[i * n + i] = rest > 0.0 ? sqrt(rest) : NAN;
            }
        }
    }
    return definite;
}

/* Solve in place for a vector (n,), by the lower Cholesky factor (n, n). */
static inline void solve(int n, const double *root, double *right)
{
    for (int i = 0; i < n; i++) {
        for (int k = 0; k < i; k++)
            right[i] -= root[i * n + k] * right[k];
        right[i] /= root[i * n + i];
    }
    for (int i = n - 1; i >= 0; i--) {
        for (int k = i + 1; k < n; k++)
            right[i] -= root[k * n + i] * right[k];
        right[i] /= root[i * n + i];
    }
}

/* Solve in place for the columns of (n, m) at once, by the lower Cholesky factor (n, n). */
static inline void solve_each(int n, int m, const double *root, double *right)
{
    for (int i = 0; i < n; i++) {
        for (int k = 0; k < i; k++)
            for (int c = 0; c < m; c++)
                right[i * m + c] -= root[i * n + k] * right[k * m + c];
        double inverse = 1.0 / root[i * n + i];
        for (int c = 0; c < m; c++)
            right[i * m + c] *= inverse;
    }
    for (int i = n - 1; i >= 0; i--) {
        for (int k = i + 1; k < n; k++)
            for (int c = 0; c < m; c++)
                right[i * m + c] -= root[k * n + i] * right[k * m + c];
        double inverse = 1.0 / root[i * n + i];
        for (int c = 0; c < m; c++)
            right[i * m + c] *= inverse;
    }
}

/* Fill in the inverse (n, n) of the matrix that a lower Cholesky factor (n, n) belongs to. */
static inline void invert(int n, const double *root, double *inverse)
{
    for (int i = 0; i < n; i++)
        for (int j = 0; j < n; j++)
            inverse[i * n + j] = i == j ? 1.0 : 0.0;
    solve_each(n, n, root, inverse);
}

/* The entry of a rank, from 0, of (n,) in any order; and the median, as numpy's. */
double select_rank(const double *values, int64_t n, int64_t rank);
double median(const double *values, int64_t n);

/* Put the `most` of n indices whose values are least first, in order; ties as they come. Gives
 * their number. */
int64_t first_by(const double *values, int64_t n, int64_t *index, int64_t most);

#endif
