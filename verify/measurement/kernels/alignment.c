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

#include "verify/core/kernels/linear_algebra.h"
#include "verify/core/kernels/scratch.h"

#define N_VIEWS 4 /* now, before, after, before the one before */

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

/* Fill in the covariance of one LED's velocity about the mean of the others, (2, 2), (px/s)^2. */
static void velocity_scatter(const double *velocity, int64_t count, const int64_t *known,
                             const double *mean, double *spread)
{
    memset(spread, 0, 4 * sizeof(double));
    if (count < 2) { /* nothing better is known than its size */
        spread[0] = square(velocity[2 * known[0]]);
        spread[3] = square(velocity[2 * known[0] + 1]);
        return;
    }
    double n = (double)count;
    for (int64_t i = 0; i < count; i++) {
        const double *own = velocity + 2 * known[i];
        for (int k = 0; k < 4; k++) {
            double off = (own[k / 2] - mean[k / 2]) * (own[k % 2] - mean[k % 2]);
            spread[k] += off / (n - 1.0) * (1.0 + 1.0 / n);
        }
    }
}

/* Carry a spot by its LED's sightings; gives how many there are, and the interval by which another
 * spot's lever is judged, s. */
static int carry_one(const View *view, int64_t i, double t, const Carried *to, double *interval)
{
    int64_t row[N_VIEWS] = {i};
    double instant[N_VIEWS] = {view[0].taken[i]}, weight[N_VIEWS], slope[N_VIEWS];
    int n = 0, k = 0;
    for (int v = 1; v < N_VIEWS; v++) {
        row[v] = v < 3 || n > 0 ? row_of(view + v, view[0].led[i]) : -1;
        if (row[v] >= 0)
            instant[++n] = view[v].taken[row[v]];
    }
    if (n == 0)
        return 0;
    to->lever[3 * i + n - 1] = lagrange_weights(n + 1, instant, t, weight, slope);
    *interval = n == 1 ? instant[0] - instant[1] : -2.0 * (t - instant[0]);
    for (int v = 0; v < N_VIEWS; v++) {
        if (row[v] < 0)
            continue;
        for (int x = 0; v > 0 && x < 2; x++) {
            double away = view[v].centre[2 * row[v] + x] - view[0].centre[2 * i + x];
            to->centre[2 * i + x] += weight[k] * away;
            to->velocity[2 * i + x] += slope[k] * away;
        }
        for (int x = 0; x < 4; x++)
            to->covariance[4 * i + x] += square(weight[k]) * view[v].covariance[4 * row[v] + x];
        k++;
    }
    return n;
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
    int64_t m = view[0].n, count = 0;
    int64_t *shared = TAKE(int64_t, m);
    bool *shown = TAKE(bool, m);
    double *intervals = TAKE(double, m), mean[2] = {0.0, 0.0}, scatter[4];
    copy(to->centre, view[0].centre, 2 * m);
    memset(to->covariance, 0, sizeof(double) * 4 * (size_t)m);
    memset(to->velocity, 0, sizeof(double) * 2 * (size_t)m);
    memset(to->lever, 0, sizeof(double) * 3 * (size_t)m);
    for (int64_t i = 0; i < m; i++) {
        shown[i] = carry_one(view, i, t, to, intervals + count) > 0;
        if (!shown[i])
            continue;
        for (int x = 0; x < 2; x++)
            mean[x] += to->velocity[2 * i + x];
        shared[count++] = i;
    }
    if (count > 0 && count < m) {
        for (int x = 0; x < 2; x++)
            mean[x] /= (double)count;
        velocity_scatter(to->velocity, count, shared, mean, scatter);
        double typical = median(intervals, count);
        for (int64_t i = 0; i < m; i++) {
            if (shown[i])
                continue;
            double shift = t - view[0].taken[i];
            for (int x = 0; x < 2; x++) {
                to->velocity[2 * i + x] = mean[x];
                to->centre[2 * i + x] = view[0].centre[2 * i + x] + mean[x] * shift;
            }
            for (int x = 0; x < 4; x++)
                to->covariance[4 * i + x] =
                    view[0].covariance[4 * i + x] + square(shift) * scatter[x];
            to->lever[3 * i] = -0.5 * shift * (shift + typical);
        }
    }
    scratch_release(mark);
    return count;
}

/* Carry normalised coordinates to pixels, distortion included. */
static void to_pixels(double x, double y, const double *matrix, const double *lens, double *pixel)
{
    double r2 = x * x + y * y, twice = 2.0 * x * y;
    double radial = 1.0 + r2 * (lens[0] + r2 * (lens[1] + r2 * lens[4]));
    double a = x * radial + lens[2] * twice + lens[3] * (r2 + 2.0 * x * x);
    double b = y * radial + lens[2] * (r2 + 2.0 * y * y) + lens[3] * twice;
    pixel[0] = matrix[0] * a + matrix[1] * b + matrix[2];
    pixel[1] = matrix[4] * b + matrix[5];
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
 * one. Gives their number. */
static int64_t led_boxes(int64_t n, const double *camera_T_flange, const double *leds,
                         const double *matrix, const double *lens, const double *half,
                         double width, double height, double *boxes)
{
    double radius = 0.0;
    int64_t count = 0;
    for (int64_t led = 0; led < n; led++)
        radius = MAX(radius, sqrt(dot(leds + 3 * led, leds + 3 * led)));
    double around = half[1] + half[2] + half[3] * radius;
    for (int64_t led = 0; led < n; led++) {
        double point[3], pixel[2];
        for (int i = 0; i < 3; i++)
            point[i] = camera_T_flange[4 * i + 3] + dot(camera_T_flange + 4 * i, leds + 3 * led);
        if (point[2] <= 0.0) /* behind the camera there is nothing to look for */
            continue;
        to_pixels(point[0] / point[2], point[1] / point[2], matrix, lens, pixel);
        double reach = half[0] + matrix[0] * around / point[2];
        double x0 = pixel[0] - reach, x1 = pixel[0] + reach;
        double y0 = pixel[1] - reach, y1 = pixel[1] + reach;
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

/* Of the views now, before, after and before the one before; filled: `Carried`, of the first. */
int64_t entry_carry_to_instant(
    int64_t n, const int64_t *led, const double *centre, const double *covariance,
    const double *taken, int64_t n1, const int64_t *led1, const double *centre1,
    const double *covariance1, const double *taken1, int64_t n2, const int64_t *led2,
    const double *centre2, const double *covariance2, const double *taken2, int64_t n3,
    const int64_t *led3, const double *centre3, const double *covariance3, const double *taken3,
    double t, double *place, double *spread, double *velocity, double *lever)
{
    View view[N_VIEWS] = {
        {n, led, centre, covariance, taken},
        {n1, led1, centre1, covariance1, taken1},
        {n2, led2, centre2, covariance2, taken2},
        {n3, led3, centre3, covariance3, taken3},
    };
    Carried to = {place, spread, velocity, lever};
    GUARDED(carry_to_instant(view, t, &to));
}

/* `half`, half a box: px; and at the LED's depth, m, m, and rad that the whole has turned; `size`,
 * px, width and height of the image; the arrays as in `led_boxes`: camera_T_flange (4, 4), LEDs
 * (n, 3), m, flange frame, camera's matrix (3, 3), px, and k1, k2, p1, p2, k3. */
int64_t entry_led_boxes(int64_t n, const double *camera_T_flange, const double *leds,
                        const double *matrix, const double *lens, double px, double m, double more,
                        double turn, double width, double height, double *boxes)
{
    double half[4] = {px, m, more, turn};
    return led_boxes(n, camera_T_flange, leds, matrix, lens, half, width, height, boxes);
}
