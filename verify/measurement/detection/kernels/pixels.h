/* Expect the pixels of a patch from a spot's parameters, and weigh them by their noise.
 *
 * A pixel at (u, w) half-widths from the centre, t^2 = xx u^2 + 2 xy u w + yy w^2, has before clipping
 *
 *     mean mu = floor + slope . d + peak f(t),  variance = read + gain max(mu - black, 0)
 *
 * and after clipping at 0 or 255 the mean and variance of the clipped normal law, in closed form. All
 * that is known of a spot's p pixels is in one array (25, p), single precision: derivatives,
 * residuals, what was read, the model.
 */
#ifndef VERIFY_PIXELS_H
#define VERIFY_PIXELS_H

#include <stdint.h>
#include <string.h>

enum { PAR_X, PAR_Y, PAR_PEAK, PAR_FLOOR, PAR_SLOPE_X, PAR_SLOPE_Y, PAR_XX, PAR_XY, PAR_YY,
       PAR_STEEPNESS, N_PARAMETERS };

/* Rows of a spot's pixels: derivatives by the parameters as above; the residual, all over each pixel's
 * sigma; value, DN; 1 where inside the image and not clipped in part; px from the patch's centre pixel;
 * the model of each pixel by the parameters. */
enum { ROW_RESIDUAL = N_PARAMETERS, N_WHITENED, ROW_VALUE = N_WHITENED, ROW_VALID, ROW_COLUMN, ROW_ROW,
       ROW_MEAN, ROW_VARIANCE, ROW_SIGNAL, ROW_USED, ROW_VISIBLE, ROW_U, ROW_W, ROW_RADIUS2, ROW_SLOPE,
       ROW_CORE, N_ROWS };

#define VECTOR 16 /* floats: rows begin where the processor's vectors do, as half of its reads else cross
                   * two lines of memory */

/* From one row of p pixels to the next one, and so between all of p floats.
 *
 * What is behind the last pixel is not valid, and counts for nothing: loops include it, as the rest
 * of a vector takes longer by itself. */
static inline int64_t pitch(int64_t p)
{
    return (p + VECTOR - 1) / VECTOR * VECTOR;
}

/* Clear what is behind the last of p pixels of a row. */
static inline void clear_behind(int64_t p, float *row)
{
    memset(row + p, 0, sizeof(float) * (size_t)(pitch(p) - p));
}

#define NEIGHBOUR_RADIUS 1.7f /* half-widths; beyond, what does not fit is a neighbour, left out */
#define OUTLIER_SIGMA 5.0f    /* sigma, of a pixel there */
#define SENSOR_LIMIT 255.0f   /* DN */
#define QUANTISATION (1.0 / 12.0) /* DN^2, the least variance that whole numbers have */

/* Profiles, (56, samples, 4) as profile.py makes them. */
typedef struct {
    const float *values;
    int64_t n_rows, n_samples;
} Table;

#define PROFILE_RADIUS_STEP (1.0f / 128.0f) /* half-widths between samples */

/* Row of the profiles that a steepness, its logarithm, has: a number from 0 to below the last. */
double profile_line(double steepness, Table table);

/* Clip p normal variables to the sensor's range: `mean`, mu, DN, and `variance`, DN^2, are those of
 * the clipped variables afterwards; `visible` is filled with d mean / d mu. */
void clip(int64_t p, float *mean, float *variance, float *visible);

/* Place one patch's pixels on the spot that parameters (10,) describe, and weigh them.
 *
 * `scale`, px, half-width that the fit starts from; `noise` (3,): read variance, gain, black; `rows`
 * (25, p): derivatives and residual, over each pixel's sigma, and the model but for ROW_CORE are filled
 * in. Gives what the pixels that are left out add to chi^2. */
double weigh_pixels(const double *parameters, double scale, const double *noise, Table table,
                    int64_t p, float *rows);

#endif
