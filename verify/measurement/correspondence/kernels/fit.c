#include "verify/measurement/correspondence/kernels/fit.h"

#include "verify/core/kernels/linear_algebra.h"
#include "verify/core/kernels/scratch.h"

typedef struct {
    double information[N_FREE * N_FREE], pull[N_FREE], chi2;
} Sums;

double predict_image(const Scene *scene, int side, int64_t led, const double *state, double nearest,
                     double *pixel, double *derivative)
{
    const double *turn = scene->camera_R_rig + 9 * side, *center = scene->center + 3 * side;
    const double *focal = scene->focal + 2 * side, *place = scene->leds + 3 * led;
    const double *position = state + POSITION, *deep = turn + 6;
    double u = dot(state, place), v = dot(state + 3, place), w = dot(state + 6, place);
    double from[3] = {u + position[0] - center[0], v + position[1] - center[1],
                      w + position[2] - center[2]};
    double depth = dot(deep, from), ahead = depth > nearest ? depth : 1.0;
    for (int axis = 0; axis < 2; axis++) {
        const double *row = turn + 3 * axis;
        double *slope = derivative + N_FREE * axis;
        double scale = focal[axis] / ahead;
        pixel[axis] = depth > nearest ? scale * dot(row, from) : 0.0;
        double lean = -pixel[axis] / ahead;
        double a = scale * row[0] + lean * deep[0], b = scale * row[1] + lean * deep[1];
        double c = scale * row[2] + lean * deep[2];
        slope[0] = a;
        slope[1] = b;
        slope[2] = c;
        slope[3] = c * v - b * w;
        slope[4] = a * w - c * u;
        slope[5] = b * u - a * v;
    }
    return depth;
}

void begin_fit(double *state, const double *sigmas)
{
    for (int i = SHIFT; i < N_STATE; i++)
        state[i] = 0.0;
    state[CHI2] = INFINITY;
    for (int i = 0; i < N_FREE; i++)
        state[COVARIANCE + i * (N_FREE + 1)] = square(sigmas[i / 3]);
    for (int i = 0; i < 6; i++)
        state[HOLD + i] = 1.0 / square(sigmas[i / 3]);
}

/* Inverse Cholesky factor of a (2, 2) covariance to whose diagonal `play` is added. */
static void whitener(const double *spread, double play, double *root)
{
    root[0] = 1.0 / sqrt(spread[0] + play);
    root[1] = 0.0;
    double slant = spread[2] * root[0];
    root[3] = 1.0 / sqrt(spread[3] + play - slant * slant);
    root[2] = -slant * root[0] * root[3];
}

/* Add a spot's share: `off` (2,), px, from its predicted image; `root` (2, 2), its whitener. */
static void add_spot(const double *off, const double *derivative, const double *root, Sums *sums)
{
    for (int axis = 0; axis < 2; axis++) {
        double x = root[2 * axis], y = root[2 * axis + 1], white[N_FREE];
        double residual = x * off[0] + y * off[1];
        sums->chi2 += residual * residual;
        for (int a = 0; a < N_FREE; a++) {
            white[a] = x * derivative[a] + y * derivative[N_FREE + a];
            sums->pull[a] += white[a] * residual;
        }
        for (int a = 0; a < N_FREE; a++)
            for (int b = 0; b < N_FREE; b++)
                sums->information[a * N_FREE + b] += white[a] * white[b];
    }
}

/* Add up the spots of a hypothesis; their whiteners (2, n, 2, 2) are kept, or `first` filled in. */
static void add_spots(const Scene *scene, Limits limits, const double *state, const int64_t *chosen,
                      bool first, double *roots, Sums *sums)
{
    double pixel[2], derivative[2 * N_FREE] = {0.0};
    *sums = (Sums){.chi2 = 0.0};
    for (int side = 0; side < 2; side++) {
        derivative[6] = derivative[N_FREE + 7] = side;
        for (int64_t led = 0; led < scene->n_leds; led++) {
            int64_t own = side * scene->n_leds + led, spot = side * scene->n_spots + chosen[own];
            if (chosen[own] < 0)
                continue;
            double depth =
                predict_image(scene, side, led, state, limits.nearest, pixel, derivative);
            double play = limits.play / MAX(depth, limits.nearest);
            if (first)
                whitener(scene->covariance + 4 * spot, play * play, roots + 4 * own);
            double off[2];
            for (int axis = 0; axis < 2; axis++)
                off[axis] =
                    scene->pixels[2 * spot + axis] - pixel[axis] - side * state[SHIFT + axis];
            add_spot(off, derivative, roots + 4 * own, sums);
        }
    }
}

static void fit_one(const Scene *scene, Limits limits, double *state, const int64_t *chosen,
                    int steps, double *roots)
{
    Sums sums;
    double root[N_FREE * N_FREE], *shift = state + SHIFT, *step = sums.pull;
    for (int done = 0; done <= steps; done++) {
        add_spots(scene, limits, state, chosen, done == 0, roots, &sums);
        for (int a = 0; a < N_FREE; a++)
            sums.information[a * (N_FREE + 1)] += a < 6 ? state[HOLD + a] : limits.shift_weight;
        factor(N_FREE, sums.information, 0.0, root);
        if (done == steps)
            break;
        step[6] -= limits.shift_weight * shift[0];
        step[7] -= limits.shift_weight * shift[1];
        solve(N_FREE, root, step);
        rotate(state, 3, step + 3);
        for (int i = 0; i < 3; i++)
            state[POSITION + i] += step[i];
        shift[0] += step[6];
        shift[1] += step[7];
    }
    invert(N_FREE, root, state + COVARIANCE);
    state[CHI2] = sums.chi2 + limits.shift_weight * (shift[0] * shift[0] + shift[1] * shift[1]);
}

void fit_all(const Scene *scene, Limits limits, int64_t count, double *state, const int64_t *chosen,
             int steps)
{
    Mark mark = scratch_mark();
    double *roots = TAKE(double, 2 * scene->n_leds * 4);
    for (int64_t h = 0; h < count; h++)
        fit_one(scene, limits, state + h * N_STATE, chosen + h * 2 * scene->n_leds, steps, roots);
    scratch_release(mark);
}
