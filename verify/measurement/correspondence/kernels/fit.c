#include "verify/measurement/correspondence/kernels/fit.h"

#include "verify/core/kernels/linear_algebra.h"
#include "verify/core/kernels/scratch.h"

typedef struct {
    double information[N_FREE * N_FREE], pull[N_FREE], chi2;
} Sums;

double predict_image(const Scene *scene, int side, int64_t led, const double *state, double *pixel,
                     double *derivative)
{
    const double *turn = scene->camera_R_rig + 9 * side, *center = scene->center + 3 * side;
    const double *focal = scene->focal + 2 * side, *place = scene->leds + 3 * led;
    const double *position = state + POSITION, *deep = turn + 6;
    double arm[3], from[3];
    for (int i = 0; i < 3; i++) {
        arm[i] = dot(state + 3 * i, place);
        from[i] = arm[i] + position[i] - center[i];
    }
    double depth = dot(deep, from);
    bool seen = depth > scene->nearest;
    for (int axis = 0; axis < 2; axis++) {
        const double *row = turn + 3 * axis;
        double *slope = derivative + N_FREE * axis, ahead = seen ? depth : 1.0;
        double scale = focal[axis] / ahead;
        pixel[axis] = seen ? scale * dot(row, from) : 0.0;
        for (int i = 0; i < 3; i++)
            slope[i] = scale * row[i] - pixel[axis] / ahead * deep[i];
        cross(arm, slope, slope + 3);
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
static void add_spots(const Scene *scene, const double *state, const int64_t *chosen, bool first,
                      double *roots, Sums *sums)
{
    double pixel[2], off[2], derivative[2 * N_FREE] = {0.0};
    *sums = (Sums){.chi2 = 0.0};
    for (int side = 0; side < 2; side++) {
        derivative[6] = derivative[N_FREE + 7] = side;
        for (int64_t led = 0; led < scene->n_leds; led++) {
            int64_t own = side * scene->n_leds + led, spot = side * scene->n_spots + chosen[own];
            if (chosen[own] < 0)
                continue;
            double depth = predict_image(scene, side, led, state, pixel, derivative);
            double play = scene->play / MAX(depth, scene->nearest);
            if (first)
                whitener(scene->covariance + 4 * spot, play * play, roots + 4 * own);
            for (int i = 0; i < 2; i++)
                off[i] = scene->pixels[2 * spot + i] - pixel[i] - side * state[SHIFT + i];
            add_spot(off, derivative, roots + 4 * own, sums);
        }
    }
}

static void fit_one(const Scene *scene, double *state, const int64_t *chosen, int steps,
                    double *roots)
{
    Sums sums;
    double root[N_FREE * N_FREE], *step = sums.pull;
    double *shift = state + SHIFT, weight = scene->shift_weight;
    for (int done = 0; done <= steps; done++) {
        add_spots(scene, state, chosen, done == 0, roots, &sums);
        for (int a = 0; a < N_FREE; a++)
            sums.information[a * (N_FREE + 1)] += a < 6 ? state[HOLD + a] : weight;
        factor(N_FREE, sums.information, 0.0, root);
        if (done == steps)
            break;
        for (int i = 0; i < 2; i++)
            step[6 + i] -= weight * shift[i];
        solve(N_FREE, root, step);
        rotate(state, 3, step + 3);
        for (int i = 0; i < 3; i++)
            state[POSITION + i] += step[i];
        for (int i = 0; i < 2; i++)
            shift[i] += step[6 + i];
    }
    invert(N_FREE, root, state + COVARIANCE);
    state[CHI2] = sums.chi2 + weight * (square(shift[0]) + square(shift[1]));
}

void fit_all(const Scene *scene, int64_t count, double *state, const int64_t *chosen, int steps)
{
    Mark mark = scratch_mark();
    double *roots = TAKE(double, 2 * scene->n_leds * 4);
    for (int64_t h = 0; h < count; h++)
        fit_one(scene, state + h * N_STATE, chosen + h * 2 * scene->n_leds, steps, roots);
    scratch_release(mark);
}
