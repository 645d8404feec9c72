#include "verify/measurement/kernels/directions.h"

#include "verify/core/kernels/linear_algebra.h"

/* LEDs nearly on a line: a turn less certain than this is no measurement, and too large for the
 * linearisation that its uncertainty rests on. */
#define MAX_UNCERTAINTY 0.1 /* rad, or 10 mm at the marker's size */
#define MIN_INFORMATION 1e-10 /* of a direction, relative to the best: rounding, not measurement */
#define MAX_SWEEPS 20 /* of Jacobi's rotations; eight do */
#define NEGLIGIBLE 1e-17 /* off the diagonal, of the largest entry */

/* Turn two vectors (6,), whose numbers stand `step` apart, into each other. */
static void turn_pair(double *one, double *other, int step, double cosine, double sine)
{
    for (int k = 0; k < N_FREE * step; k += step) {
        double held = one[k];
        one[k] = cosine * held - sine * other[k];
        other[k] = sine * held + cosine * other[k];
    }
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
    for (int round = 0; round < MAX_SWEEPS * N_FREE * N_FREE; round++) {
        int p = round / N_FREE % N_FREE, q = round % N_FREE;
        double off = matrix[p * N_FREE + q];
        if (q <= p || !(fabs(off) > NEGLIGIBLE * largest))
            continue;
        double half = (matrix[q * N_FREE + q] - matrix[p * N_FREE + p]) / (2.0 * off);
        double t = copysign(1.0, half) / (fabs(half) + sqrt(half * half + 1.0));
        double cosine = 1.0 / sqrt(t * t + 1.0), sine = t * cosine;
        turn_pair(matrix + p, matrix + q, N_FREE, cosine, sine);
        turn_pair(vectors + p, vectors + q, N_FREE, cosine, sine);
        turn_pair(matrix + p * N_FREE, matrix + q * N_FREE, 1, cosine, sine);
    }
}

bool covariance_of(const double *information, double *inverse, double *vectors, bool *known)
{
    double scaled[N_FREE * N_FREE], root[N_FREE * N_FREE], trace = 0.0, best = 0.0;
    for (int i = 0; i < N_FREE * N_FREE; i++)
        scaled[i] = information[i] * SCALE[i / N_FREE] * SCALE[i % N_FREE];
    for (int i = 0; i < N_FREE; i++) {
        trace += scaled[i * (N_FREE + 1)];
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
        for (int k = 0; k < N_FREE; k++)
            best = MAX(best, scaled[k * (N_FREE + 1)]);
        for (int k = 0; k < N_FREE; k++) {
            double value = scaled[k * (N_FREE + 1)];
            const double *vector = vectors + k;
            known[k] = value > MAX(MIN_INFORMATION * best, least);
            for (int i = 0; known[k] && i < N_FREE * N_FREE; i++)
                inverse[i] += vector[i / N_FREE * N_FREE] * vector[i % N_FREE * N_FREE] / value;
        }
    }
    for (int i = 0; i < N_FREE * N_FREE; i++)
        inverse[i] *= SCALE[i / N_FREE] * SCALE[i % N_FREE];
    return true;
}

int64_t entry_covariance_of(const double *information, double *inverse, double *vectors,
                            bool *known)
{
    return covariance_of(information, inverse, vectors, known);
}
