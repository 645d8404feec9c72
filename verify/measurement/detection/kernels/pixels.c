#include "verify/measurement/detection/kernels/pixels.h"

#include <math.h>

#include "verify/core/kernels/linear_algebra.h"
#include "verify/core/kernels/scratch.h"

#define CLIP_REACH 4.5f /* sigma from a limit within which clipping is computed */
#define MIN_Z (-9.0f)   /* sigma: below, a clipped pixel shows nothing */
#define STEPS_PER_UNIT 256 /* entries of a table of the normal law */
#define N_ENTRIES (27 * STEPS_PER_UNIT / 2 + 2)
/* of the profiles, as profile.py */
#define MIN_PROFILE log(1.05)
#define ROW_STEP ((log(32.0) - log(1.05)) / 55.0)
#define MAX_RADIUS 8.0f
#define BLOCK 256 /* pixels that are looked up together */

static float share_below[N_ENTRIES], density_at[N_ENTRIES]; /* of a standard normal variable */

__attribute__((constructor)) static void tabulate_normal_law(void)
{
    for (int n = 0; n < N_ENTRIES; n++) {
        double z = (double)MIN_Z + n / (double)STEPS_PER_UNIT;
        share_below[n] = (float)(0.5 * erfc(-z / sqrt(2.0)));
        density_at[n] = (float)(exp(-0.5 * z * z) / sqrt(2.0 * acos(-1.0)));
    }
}

void clip(int64_t p, float *restrict mean, float *restrict variance, float *restrict visible)
{
    int64_t near = 0;
#pragma omp simd reduction(+ : near)
    for (int64_t k = 0; k < p; k++) { /* the farther limit is always out of reach */
        float room = MIN(SENSOR_LIMIT - mean[k], mean[k]), z = room / sqrtf(variance[k]);
        near += z < CLIP_REACH;
        visible[k] = z > MIN_Z ? MIN(z, CLIP_REACH) : MIN_Z;
    }
    if (near == 0) {
        for (int64_t k = 0; k < p; k++)
            visible[k] = 1.0f;
        return;
    }
#pragma omp simd
    for (int64_t k = 0; k < p; k++) {
        float top = SENSOR_LIMIT - mean[k], room = MIN(top, mean[k]), z = visible[k];
        /* a Taylor series about the next entry of the table */
        int32_t entry = (int32_t)((z - MIN_Z) * STEPS_PER_UNIT + 0.5f);
        float node = (float)entry / STEPS_PER_UNIT + MIN_Z, off = z - node;
        float curved = off * (node * node - 1.0f), here = density_at[entry];
        float density = here * (1.0f + off * (0.5f * curved - node));
        float inside = share_below[entry];
        inside += here * off * (1.0f + off * (curved * (1.0f / 6.0f) - 0.5f * node));
        /* E[u^2] less E[u]^2, u the clipped room. No less than rounding: a deviation there is the
         * model's, not the noise's. */
        float excess = room * inside + density * sqrtf(variance[k]);
        float clipped = variance[k] * inside + excess * (room - excess);
        float middle = top < mean[k] ? SENSOR_LIMIT - excess : excess;
        clipped = MAX(clipped, (float)QUANTISATION);
        variance[k] = z < CLIP_REACH ? clipped : variance[k];
        mean[k] = z < CLIP_REACH ? middle : mean[k];
        visible[k] = z < CLIP_REACH ? inside : 1.0f;
    }
}

double profile_line(double steepness, Table table)
{
    double place = (steepness - MIN_PROFILE) / ROW_STEP;
    return MIN(MAX(place, 0.0), (double)table.n_rows - 1.001);
}

/* Fill in f, df / d(t^2) and df / d(ln steepness) from the table, to first order in t^2.
 *
 * A sample's four numbers are copied as one: where the processor gathers them, a picture takes 4 %
 * longer. */
static void look_up(double steepness, Table table, int64_t p, const float *restrict radius2,
                    float *restrict height, float *restrict slope, float *restrict steeper)
{
    double place = profile_line(steepness, table);
    int64_t line = (int64_t)place;
    float share = (float)(place - (double)line), end = (float)(table.n_samples - 1);
    const float *samples = table.values + 4 * table.n_samples * line;
    float beyond[BLOCK], copied[4 * BLOCK];
    int32_t sample[BLOCK];
    for (int64_t begin = 0; begin < p; begin += BLOCK) {
        int64_t count = MIN(BLOCK, p - begin);
#pragma omp simd
        for (int64_t k = 0; k < count; k++) {
            float nearest = sqrtf(radius2[begin + k]) / PROFILE_RADIUS_STEP + 0.5f;
            sample[k] = (int32_t)MIN(nearest, end);
            /* past the table the profile stays constant */
            float at = (float)sample[k] * PROFILE_RADIUS_STEP;
            beyond[k] = MIN(radius2[begin + k] - at * at, 2.0f * MAX_RADIUS * PROFILE_RADIUS_STEP);
        }
        for (int64_t k = 0; k < count; k++)
            memcpy(copied + 4 * k, samples + 4 * sample[k], 4 * sizeof(float));
#pragma omp simd
        for (int64_t k = 0; k < count; k++) {
            const float *one = copied + 4 * k;
            slope[begin + k] = one[2] + share * one[3];
            height[begin + k] = one[0] + share * one[1] + slope[begin + k] * beyond[k];
            steeper[begin + k] = one[1];
        }
    }
}

double weigh_pixels(const double *parameters, double scale, const double *noise, Table table,
                    int64_t p, float *rows)
{
    p = pitch(p);
    float of[N_PARAMETERS], inverse = (float)(1.0 / scale);
    for (int a = 0; a < N_PARAMETERS; a++)
        of[a] = (float)parameters[a];
    const float *restrict column = rows + ROW_COLUMN * pitch(p);
    const float *restrict row = rows + ROW_ROW * pitch(p);
    const float *restrict value = rows + ROW_VALUE * pitch(p);
    const float *restrict valid = rows + ROW_VALID * pitch(p);
    float *restrict u = rows + ROW_U * pitch(p), *restrict w = rows + ROW_W * pitch(p);
    float *restrict radius2 = rows + ROW_RADIUS2 * pitch(p);
    float *restrict slope = rows + ROW_SLOPE * pitch(p);
    float *restrict by_x = rows + PAR_X * pitch(p), *restrict by_y = rows + PAR_Y * pitch(p);
    float *restrict by_peak = rows + PAR_PEAK * pitch(p);
    float *restrict by_floor = rows + PAR_FLOOR * pitch(p);
    float *restrict by_slope_x = rows + PAR_SLOPE_X * pitch(p);
    float *restrict by_xx = rows + PAR_XX * pitch(p);
    float *restrict by_slope_y = rows + PAR_SLOPE_Y * pitch(p);
    float *restrict by_xy = rows + PAR_XY * pitch(p);
    float *restrict by_yy = rows + PAR_YY * pitch(p);
    float *restrict by_steepness = rows + PAR_STEEPNESS * pitch(p);
    float *restrict mean = rows + ROW_MEAN * pitch(p);
    float *restrict variance = rows + ROW_VARIANCE * pitch(p);
    float *restrict signal = rows + ROW_SIGNAL * pitch(p);
    float *restrict used = rows + ROW_USED * pitch(p);
    float *restrict visible = rows + ROW_VISIBLE * pitch(p);
    float *restrict residual = rows + ROW_RESIDUAL * pitch(p);
#pragma omp simd
    for (int64_t k = 0; k < p; k++) {
        u[k] = (column[k] - of[PAR_X]) * inverse;
        w[k] = (row[k] - of[PAR_Y]) * inverse;
        by_x[k] = of[PAR_XX] * u[k] + of[PAR_XY] * w[k];
        by_y[k] = of[PAR_XY] * u[k] + of[PAR_YY] * w[k];
        float square = by_x[k] * u[k] + by_y[k] * w[k];
        radius2[k] = square > 0.0f ? square : 0.0f;
    }
    look_up(parameters[PAR_STEEPNESS], table, p, radius2, by_peak, slope, by_steepness);
    float read = (float)noise[0], gain = (float)noise[1], black = (float)noise[2];
#pragma omp simd
    for (int64_t k = 0; k < p; k++) {
        float plane = of[PAR_FLOOR] + of[PAR_SLOPE_X] * column[k] + of[PAR_SLOPE_Y] * row[k];
        mean[k] = plane + of[PAR_PEAK] * by_peak[k];
        signal[k] = MAX(mean[k] - black, 0.0f);
        variance[k] = residual[k] = read + gain * signal[k];
    }
    clip(p, mean, variance, visible);
    float lever = (float)(-2.0 * parameters[PAR_PEAK] / scale), left_out = 0.0f;
    float steep = (float)(parameters[PAR_PEAK] / ROW_STEP);
#pragma omp simd reduction(+ : left_out)
    for (int64_t k = 0; k < p; k++) {
        /* what lies far out and does not fit is a neighbour's; judged by the unclipped variance */
        float off = value[k] - mean[k];
        bool far = (off * off > OUTLIER_SIGMA * OUTLIER_SIGMA * residual[k])
                   & (radius2[k] > NEIGHBOUR_RADIUS * NEIGHBOUR_RADIUS);
        used[k] = far ? 0.0f : valid[k];
        left_out += valid[k] - used[k];
        float weight = used[k] * sqrtf(1.0f / variance[k]), change = weight * visible[k];
        float bent = change * slope[k];
        residual[k] = weight * off;
        by_x[k] *= lever * bent;
        by_y[k] *= lever * bent;
        by_peak[k] *= change;
        by_floor[k] = change;
        by_slope_x[k] = change * column[k];
        by_slope_y[k] = change * row[k];
        bent *= of[PAR_PEAK];
        by_xx[k] = bent * u[k] * u[k];
        by_xy[k] = 2.0f * bent * u[k] * w[k];
        by_yy[k] = bent * w[k] * w[k];
        by_steepness[k] *= steep * change;
    }
    return (double)(OUTLIER_SIGMA * OUTLIER_SIGMA) * (double)left_out;
}

int64_t entry_clip(int64_t p, float *mean, float *variance, float *visible)
{
    clip(p, mean, variance, visible);
    return 0;
}
