/* Carry spots to another instant along their image motion; box the LEDs that a pose predicts.
 *
 * A spot taken at t_0 and its LED's sightings at t_1 ... t_n in n neighbouring pictures lie on a
 * polynomial; at the instant t it has the covariance of their sum, each with its Lagrange
 * weight, and
 *
 *     the lever  -(t - t_0) ... (t - t_n) / (n + 1)!
 *
 * of the derivative of order n + 1 that these sightings do not show: acceleration, jerk or snap.
 */
#include "verify/measurement/kernels/alignment.h"

#include "verify/core/kernels/camera.h"
#include "verify/core/kernels/linear_algebra.h"
#include "verify/core/kernels/scratch.h"

#define N_VIEWS 4 /* now, before, after, before the one before */
#define TOL_INSTANT 1e-9 /* s, closer than any camera's clock */

typedef struct { /* n spots of one picture */
    int64_t n;
    const int64_t *led; /* (n,) */
    const double *centre, *covariance, *taken; /* (n, 2) px, (n, 2, 2) px^2, (n,) s */
} View;

typedef struct { /* n spots at the instant */
    double *centre, *covariance, *velocity; /* (n, 2), px; (n, 2, 2), px^2; (n, 2), px/s */
    double *lever; /* (n, 3), s^2, s^3, s^4 */
} Carried;

/* Where an LED stands among a picture's, -1 where it does not. */
static int64_t row_of(const View *view, int64_t wanted)
{
    for (int64_t k = 0; k < view->n; k++)
        if (view->led[k] == wanted)
            return k;
    return -1;
}

/* Fill in the weights of values at n instants in the value and the slope, 1/s, at t, s. Gives the
 * error, by one unit of the derivative of order n that the values do not show. */
static double lagrange_weights(int n, const double *instant, double t, double *weight,
                               double *slope)
{
    double error = -1.0;
    for (int a = 0; a < n; a++) {
        error *= (t - instant[a]) / (a + 1.0);
        weight[a] = 1.0;
        slope[a] = 0.0;
        for (int b = 0; b < n; b++) {
            if (b == a)
                continue;
            double apart = instant[a] - instant[b];
            slope[a] = (slope[a] * (t - instant[b]) + weight[a]) / apart;
            weight[a] *= (t - instant[b]) / apart;
        }
    }
    return error;
}

/* Carry a spot by its LED's sightings; gives whether there are any, and the interval by which
 * another spot's lever is judged, s. */
static bool carry_one(const View *view, int64_t i, double t, const Carried *to, double *interval)
{
    const View *seen[N_VIEWS] = {view};
    int64_t row[N_VIEWS] = {i};
    double instant[N_VIEWS] = {view->taken[i]}, weight[N_VIEWS], slope[N_VIEWS];
    int n = 0;
    for (int v = 1; v < N_VIEWS; v++) {
        int64_t found = v < 3 || n > 0 ? row_of(view + v, view->led[i]) : -1;
        if (found < 0)
            continue;
        seen[++n] = view + v;
        row[n] = found;
        instant[n] = view[v].taken[found];
    }
    if (n == 0)
        return false;
    to->lever[3 * i + n - 1] = lagrange_weights(n + 1, instant, t, weight, slope);
    *interval = n == 1 ? instant[0] - instant[1] : -2.0 * (t - instant[0]);
    for (int k = 0; k <= n; k++) {
        for (int x = 0; x < 2; x++) {
            double away = seen[k]->centre[2 * row[k] + x] - view->centre[2 * i + x];
            to->centre[2 * i + x] += weight[k] * away;
            to->velocity[2 * i + x] += slope[k] * away;
        }
        for (int x = 0; x < 4; x++)
            to->covariance[4 * i + x] += square(weight[k]) * seen[k]->covariance[4 * row[k] + x];
    }
    return true;
}

/* Fill in the mean velocity (2,) of the `count` LEDs that are shown, and the covariance (2, 2) of
 * another's about it, (px/s)^2. */
static void velocity_scatter(int64_t m, const bool *shown, double count, const double *velocity,
                             double *mean, double *spread)
{
    clear(mean, 2);
    clear(spread, 4);
    for (int64_t i = 0; i < 2 * m; i++)
        mean[i % 2] += velocity[i] / count; /* 0 of the others */
    if (count < 2.0) { /* nothing better is known than its size */
        spread[0] = square(mean[0]);
        spread[3] = square(mean[1]);
        return;
    }
    for (int64_t i = 0; i < m; i++) {
        for (int k = 0; shown[i] && k < 4; k++) {
            double x = velocity[2 * i + k / 2] - mean[k / 2];
            double y = velocity[2 * i + k % 2] - mean[k % 2];
            spread[k] += x * y / (count - 1.0) * (1.0 + 1.0 / count);
        }
    }
}

/* Carry the spots of the first view to an instant t, s, by what neighbouring pictures show of their
 * LEDs.
 *
 * LEDs that no neighbour shows move like the others, with their spread as uncertainty. The other
 * views: the pictures before, after, and before the one before, which counts only beside one of the
 * others. Gives how many LEDs a neighbour shows too, without which nothing else is of use. */
static int64_t carry_to_instant(const View *view, double t, const Carried *to)
{
    Mark mark = scratch_mark();
    int64_t m = view->n, count = 0;
    bool *shown = TAKE(bool, m);
    double *intervals = TAKE(double, m), mean[2], scatter[4];
    copy(to->centre, view->centre, 2 * m);
    clear(to->covariance, 4 * m);
    clear(to->velocity, 2 * m);
    clear(to->lever, 3 * m);
    for (int64_t i = 0; i < m; i++) {
        shown[i] = carry_one(view, i, t, to, intervals + count);
        count += shown[i];
    }
    double typical = count > 0 ? median(intervals, count) : 0.0;
    velocity_scatter(m, shown, (double)count, to->velocity, mean, scatter);
    for (int64_t i = 0; i < m; i++) {
        if (shown[i])
            continue;
        double shift = t - view->taken[i];
        for (int x = 0; x < 2; x++) {
            to->velocity[2 * i + x] = mean[x];
            to->centre[2 * i + x] += mean[x] * shift;
        }
        for (int x = 0; x < 4; x++)
            to->covariance[4 * i + x] = view->covariance[4 * i + x] + square(shift) * scatter[x];
        to->lever[3 * i] = -0.5 * shift * (shift + typical);
    }
    scratch_release(mark);
    return count;
}

/* Align one picture's spots as above; where no neighbour shows any of them, those that were taken at
 * the instant stay as they are. False where they were not. */
static bool align_side(const View *view, double t, const Carried *to)
{
    if (view->n == 0 || carry_to_instant(view, t, to) > 0)
        return true;
    copy(to->centre, view->centre, 2 * view->n);
    copy(to->covariance, view->covariance, 4 * view->n);
    clear(to->velocity, 2 * view->n);
    clear(to->lever, 3 * view->n);
    for (int64_t i = 0; i < view->n; i++)
        if (!(fabs(t - view->taken[i]) < TOL_INSTANT))
            return false;
    return true;
}

/* The spots of the left picture, the first `left` of the n, or those of the right one. */
static View side_of(View both, int64_t left, int side)
{
    int64_t first = side ? left : 0;
    return (View){side ? both.n - left : left, both.led + first, both.centre + 2 * first,
                  both.covariance + 4 * first, both.taken + first};
}

/* Align both pictures' spots, `left` (4,) of each view those of the left one. */
static int64_t align_spots(const View *view, const int64_t *left, double t, Carried to)
{
    bool aligned = true;
    for (int side = 0; side < 2; side++) {
        View seen[N_VIEWS];
        int64_t first = side ? left[0] : 0;
        Carried part = {to.centre + 2 * first, to.covariance + 4 * first, to.velocity + 2 * first,
                        to.lever + 3 * first};
        for (int v = 0; v < N_VIEWS; v++)
            seen[v] = side_of(view[v], left[v], side);
        aligned = align_side(seen, t, &part) && aligned;
    }
    return aligned;
}

/* Of the views now, before, after and before the one before, each with its spots of the left picture
 * first; filled: `Carried`, of the first. */
int64_t entry_align_spots(
    int64_t n, int64_t left, const int64_t *led, const double *centre, const double *covariance,
    const double *taken, int64_t n1, int64_t left1, const int64_t *led1, const double *centre1,
    const double *covariance1, const double *taken1, int64_t n2, int64_t left2,
    const int64_t *led2, const double *centre2, const double *covariance2, const double *taken2,
    int64_t n3, int64_t left3, const int64_t *led3, const double *centre3,
    const double *covariance3, const double *taken3, double t, double *place, double *spread,
    double *velocity, double *lever)
{
    View view[N_VIEWS] = {
        {n, led, centre, covariance, taken},
        {n1, led1, centre1, covariance1, taken1},
        {n2, led2, centre2, covariance2, taken2},
        {n3, led3, centre3, covariance3, taken3},
    };
    Carried to = {place, spread, velocity, lever};
    GUARDED(align_spots(view, (int64_t[]){left, left1, left2, left3}, t, to));
}

int64_t merge_boxes(int64_t n, double *boxes)
{
    for (int64_t one = 0; one < n; one++) {
        double *a = boxes + 4 * one;
        for (int64_t other = one + 1; other < n; other++) {
            double *b = boxes + 4 * other;
            if (!(a[0] <= b[2] && b[0] <= a[2] && a[1] <= b[3] && b[1] <= a[3]))
                continue;
            for (int i = 0; i < 2; i++) {
                a[i] = MIN(a[i], b[i]);
                a[i + 2] = MAX(a[i + 2], b[i + 2]);
            }
            n--;
            memmove(b, boxes + 4 * n, 4 * sizeof(double));
            other = one; /* it has grown: the others are looked at anew */
        }
    }
    return n;
}

/* Fill in boxes about n LEDs in the image, (n, 4), px: x0, y0, x1, y1; those that overlap become
 * one. Gives their number.
 *
 * LEDs (n, 3), m, flange frame; camera's matrix (3, 3), px, and lens (5,). Half a box: px; and at
 * the LED's depth m and more, m, and the turn of the whole, rad. Width and height of the image,
 * px. */
int64_t entry_led_boxes(int64_t n, const double *camera_T_flange, const double *leds,
                        const double *matrix, const double *lens, double px, double m, double more,
                        double turn, double width, double height, double *boxes)
{
    double radius = 0.0;
    int64_t count = 0;
    for (int64_t led = 0; led < n; led++)
        radius = MAX(radius, sqrt(dot(leds + 3 * led, leds + 3 * led)));
    double around = m + more + turn * radius;
    for (int64_t led = 0; led < n; led++) {
        double point[3];
        place_point(camera_T_flange, leds + 3 * led, point);
        if (point[2] <= 0.0) /* behind the camera there is nothing to look for */
            continue;
        Bent ray = bend(lens, point[0] / point[2], point[1] / point[2]);
        double x = matrix[0] * ray.x + matrix[1] * ray.y + matrix[2];
        double y = matrix[4] * ray.y + matrix[5], reach = px + matrix[0] * around / point[2];
        double x0 = x - reach, x1 = x + reach, y0 = y - reach, y1 = y + reach;
        if (x1 > 0.0 && y1 > 0.0 && x0 < width - 1.0 && y0 < height - 1.0) {
            double *box = boxes + 4 * count++;
            box[0] = MAX(x0, 0.0);
            box[1] = MAX(y0, 0.0);
            box[2] = MIN(x1, width);
            box[3] = MIN(y1, height);
        }
    }
    return merge_boxes(count, boxes);
}
