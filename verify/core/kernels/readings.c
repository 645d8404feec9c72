/* Interpolate joint readings: values, interpolation errors, directions of travel.
 *
 * Between readings h apart, s the share of h passed, values follow the cubic with the speeds v0, v1
 * of second-order differences at both ends (Catmull-Rom); an error e0, e1 of these speeds makes
 *
 *     h s (1 - s) (e0 (1 - s) + e1 s)
 */
#include "verify/core/kernels/linear_algebra.h"

#define N_END_READINGS 4 /* through which a cubic gives the speed at an end */
/* Of the time from a turning point to the threshold, a parabola is within half of it for 0.71. */
#define RESTED 0.85

typedef struct { /* m readings, two at least, of several joints */
    int64_t m, joints;
    const double *t, *q; /* (m,), s, increasing; (m, joints), rad */
    double longest; /* s; across a longer gap the nearest reading is held */
} Readings;

/* A joint's speed at reading i from those on one side of it, by a polynomial.
 *
 * The newest interval is all that a live pair has: a straight line there errs by 7 % of
 * acceleration times interval squared, 0.3 deg for a brisk joint read at 9 Hz. Neighbours lie
 * `way`, 1 or -1; those beyond a gap are left alone. The polynomial goes through `most`
 * readings, N_END_READINGS at most, if there are as many.
 *
 * Source: Newton's divided differences. */
static double one_sided_slope(const Readings *of, int64_t i, int way, int64_t joint, int64_t most)
{
    const double *t = of->t;
    double slope = 0.0, lever = 1.0, columns[N_END_READINGS];
    for (int k = 0; k < most; k++) {
        int64_t at = i + way * k;
        if (at < 0 || at >= of->m || (k > 0 && fabs(t[at] - t[at - way]) > of->longest))
            break;
        columns[k] = of->q[at * of->joints + joint];
        for (int order = 1; order <= k; order++) { /* the next divided difference, in place */
            double *first = columns + k - order;
            *first = (first[1] - first[0]) / (t[at] - t[at - way * order]);
        }
        if (k > 0) {
            slope += lever * columns[0];
            lever *= t[i] - t[at];
        }
    }
    return slope;
}

static double before(const Readings *of, int64_t i)
{
    return i > 0 ? of->t[i] - of->t[i - 1] : 0.0;
}

static double after(const Readings *of, int64_t i)
{
    return i < of->m - 1 ? of->t[i + 1] - of->t[i] : 0.0;
}

/* A joint's speed at reading i by second-order differences, as numpy.gradient; 0 beside a gap. */
static double slope_at(const Readings *of, int64_t i, int64_t joint)
{
    double b = before(of, i), a = after(of, i);
    if (b > of->longest || a > of->longest)
        return 0.0; /* a slope across a gap means nothing */
    if (b == 0.0 || a == 0.0)
        return one_sided_slope(of, i, b == 0.0 ? 1 : -1, joint, MIN(N_END_READINGS, of->m));
    const double *q = of->q + i * of->joints + joint;
    double late = b * b * q[of->joints], early = a * a * q[-of->joints];
    double middle = (a * a - b * b) * *q;
    return (late + middle - early) / (b * a * (b + a));
}

/* How much a joint's speed at reading i differs from what another polynomial makes it: at an end,
 * one of an order less; of two readings alone, rest. */
static double slope_difference(const Readings *of, int64_t i, int64_t joint)
{
    bool at_end = i == 0 || i == of->m - 1;
    int64_t other = MIN(N_END_READINGS, of->m) - (at_end ? 1 : 0);
    int way = i > 1 || i == of->m - 1 ? -1 : 1;
    if (before(of, i) > of->longest || after(of, i) > of->longest)
        return 0.0;
    return fabs(slope_at(of, i, joint) - one_sided_slope(of, i, way, joint, other));
}

/* The instant, no earlier than the first reading, no later than the last. */
static double within(const Readings *of, double instant)
{
    double first = of->t[0], last = of->t[of->m - 1];
    return MIN(MAX(instant, first), last);
}

/* The first reading, from the second on, that is not earlier than an instant; the last if none. */
static int64_t next_reading(const Readings *of, double instant)
{
    int64_t low = 1, high = of->m - 1;
    while (low < high) {
        int64_t half = (low + high) / 2;
        if (of->t[half] >= instant)
            high = half;
        else
            low = half + 1;
    }
    return low;
}

static void interpolate(const Readings *of, double instant, double *values)
{
    int64_t next = next_reading(of, instant);
    double width = of->t[next] - of->t[next - 1], passed = instant - of->t[next - 1];
    for (int64_t j = 0; j < of->joints; j++) {
        double late = of->q[next * of->joints + j], early = of->q[(next - 1) * of->joints + j];
        if (width > of->longest) {
            values[j] = passed < of->t[next] - instant ? early : late;
            continue;
        }
        double straight = (late - early) / width;
        double begin = slope_at(of, next - 1, j), end = slope_at(of, next, j);
        double twist = (begin + end - 2.0 * straight) / width;
        double bend = (straight - begin) / width - twist;
        values[j] = early + passed * (begin + passed * (bend + passed * (twist / width)));
    }
}

/* A cubic takes a speed's error at one of its ends to h s (1 - s)^2, s the share of h from
 * there. */
static void interpolation_error(const Readings *of, double instant, double *values)
{
    int64_t next = next_reading(of, instant);
    double width = of->t[next] - of->t[next - 1], late = (instant - of->t[next - 1]) / width;
    double early = 1.0 - late;
    for (int64_t j = 0; j < of->joints; j++) {
        values[j] = 0.0;
        if (width <= of->longest) {
            double begin = slope_difference(of, next - 1, j), end = slope_difference(of, next, j);
            values[j] = width * late * early * (begin * early + end * late);
        }
    }
}

/* Reading from which on a joint moves back, of q (m,), rad, `step` apart, beyond the threshold at
 * `found`.
 *
 * A joint that turns without a rest is as long on its way there as on its way back. After a rest,
 * it moves from the last reading on that is within half of the threshold. */
static int64_t turning_point(const double *q, int64_t step, int64_t found, double extreme,
                             double threshold)
{
    int64_t begin = found - 1, last = -1;
    for (; begin >= 0 && fabs(q[begin * step] - extreme) <= threshold; begin--)
        if (last < 0 && fabs(q[begin * step] - extreme) <= threshold / 2.0)
            last = begin;
    int64_t middle = (begin + found + 1) / 2;
    bool rested = begin < 0 || (double)(last - middle) > RESTED * (double)(found - middle);
    return rested ? last + 1 : middle;
}

/* Readings (n, joints), rad, at instants (n,), s: cubic between four readings (Catmull-Rom). */
int64_t entry_interpolate(int64_t m, int64_t joints, const double *t, const double *q,
                          double longest, int64_t n, const double *instants, double *values)
{
    Readings readings = {m, joints, t, q, longest};
    for (int64_t i = 0; i < n; i++)
        interpolate(&readings, within(&readings, instants[i]), values + joints * i);
    return 0;
}

/* Whether an instant's speed is known: no gap before the next reading, or a reading itself.
 *
 * `without_gap` (m + 1,): before each reading, and after the last. */
static bool speed_known(const Readings *of, const bool *without_gap, double instant)
{
    int64_t next = 0, high = of->m;
    while (next < high) {
        int64_t half = (next + high) / 2;
        if (of->t[half] < instant)
            next = half + 1;
        else
            high = half;
    }
    return without_gap[next] || of->t[MIN(next, of->m - 1)] == instant;
}

/* Joints' speeds over twice `span`, s, about an instant, or what there is of it; `early` (joints,)
 * is overwritten. */
static void rates(const Readings *of, double instant, double span, double *early, double *values)
{
    double begin = within(of, instant - span), end = within(of, instant + span);
    double apart = MAX(end - begin, span);
    interpolate(of, begin, early);
    interpolate(of, end, values);
    for (int64_t j = 0; j < of->joints; j++)
        values[j] = (values[j] - early[j]) / apart;
}

/* Readings and joint speeds (n, joints), rad and rad/s, at instants (n,), s; speed 0 in a gap. */
int64_t entry_sample_motion(int64_t m, int64_t joints, const double *t, const double *q,
                            double longest, const bool *without_gap, double span, int64_t n,
                            const double *instants, double *values, double *speeds)
{
    Readings readings = {m, joints, t, q, longest};
    for (int64_t i = 0; i < n; i++) {
        double *value = values + joints * i, *speed = speeds + joints * i;
        if (speed_known(&readings, without_gap, instants[i]))
            rates(&readings, instants[i], span, value, speed);
        else
            clear(speed, joints);
        interpolate(&readings, within(&readings, instants[i]), value);
    }
    return 0;
}

/* Error that `interpolate` may have at some instants, (n, joints), rad. */
int64_t entry_interpolation_error(int64_t m, int64_t joints, const double *t, const double *q,
                                  double longest, int64_t n, const double *instants,
                                  double *values)
{
    Readings readings = {m, joints, t, q, longest};
    for (int64_t i = 0; i < n; i++)
        interpolation_error(&readings, within(&readings, instants[i]), values + joints * i);
    return 0;
}

/* Joints' direction of travel (m, joints) after each reading: +1, -1, or 0 before any.
 *
 * q (m, joints), rad; beyond its threshold (joints,), rad, from its extreme a joint has turned
 * back. From when on, is then sought. */
int64_t entry_travel_directions(int64_t m, int64_t joints, const double *q,
                                const double *thresholds, int8_t *directions)
{
    for (int64_t j = 0; m > 0 && j < joints; j++) {
        double extreme = q[j];
        int8_t direction = 0;
        for (int64_t i = 0; i < m; i++) {
            double value = q[i * joints + j];
            if ((value - extreme) * direction > 0.0) {
                extreme = value;
            } else if (fabs(value - extreme) > thresholds[j]) {
                direction = value > extreme ? 1 : -1;
                int64_t k = turning_point(q + j, joints, i, extreme, thresholds[j]);
                for (; k < i; k++)
                    directions[k * joints + j] = direction;
                extreme = value;
            }
            directions[i * joints + j] = direction;
        }
    }
    return 0;
}
