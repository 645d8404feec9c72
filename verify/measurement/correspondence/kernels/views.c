/* Bring the spots of one image into ideal coordinates, with noise, and say which LED each may be.
 *
 * A spot's ideal pixel is its own, the lens undone by Newton's method, from the principal point. It
 * may be an LED unless their colours clearly differ.
 */
#include "verify/measurement/correspondence/kernels/views.h"

#include "verify/core/kernels/camera.h"
#include "verify/core/kernels/linear_algebra.h"

/* channels of a colour, and LEDs that shine in them; LEDs without a hue, and those that may have
 * any */
enum { BLUE, GREEN, RED, WHITE, ANY };
/* (largest - second) / largest channel: warm white stays under 0.2, LEDs above 0.4 */
#define MIN_HUE_CONTRAST 0.3
#define MAX_STEPS 30  /* quadratic convergence: three or four suffice for any sane lens */
#define TOL_STEP 1e-9 /* the next step would be about the square of this one: below rounding */

/* Invert in place OpenCV's distortion k1, k2, p1, p2, k3 (5,) by Newton's method, as
 * `rig.undistort`. */
static void undistort(const double *lens, double *point)
{
    double x = point[0], y = point[1];
    for (int n = 0; n < MAX_STEPS; n++) {
        Bent ray = bend(lens, point[0], point[1]);
        double off_x = ray.x - x, off_y = ray.y - y;
        double determinant = ray.xx * ray.yy - ray.xy * ray.xy;
        double step_x = (off_x * ray.yy - off_y * ray.xy) / determinant;
        double step_y = (off_y * ray.xx - off_x * ray.xy) / determinant;
        point[0] -= step_x;
        point[1] -= step_y;
        if (!(fabs(step_x) > TOL_STEP || fabs(step_y) > TOL_STEP))
            break;
    }
}

static bool is_grey(int64_t count, const double *colour)
{
    for (const double *spot = colour; spot < colour + 3 * count; spot += 3)
        if (!(spot[0] == spot[1] && spot[1] == spot[2]))
            return false;
    return true;
}

/* Channel of a colour (3,) that clearly outshines the others, or WHITE. */
static int hue_of(const double *colour)
{
    int most = 0;
    double second = -INFINITY;
    for (int channel = 1; channel < 3; channel++) {
        if (colour[channel] > colour[most]) {
            second = colour[most];
            most = channel;
        } else {
            second = MAX(second, colour[channel]);
        }
    }
    bool clear = colour[most] - second > MIN_HUE_CONTRAST * fabs(colour[most]);
    return clear ? most : WHITE;
}

void prepare_image(ImageSpots spots, const double *matrix, const double *lens, double beside,
                   double dragged, int64_t n_leds, const int64_t *light, int64_t most,
                   double *pixels, double *covariance, bool *merged, bool *allowed)
{
    bool grey = is_grey(spots.count, spots.colour);
    for (int64_t k = 0; k < most; k++) {
        double *pixel = pixels + 2 * k, *spread = covariance + 4 * k;
        bool exists = k < spots.count;
        merged[k] = exists && spots.merged[k];
        for (int64_t led = 0; led < n_leds; led++)
            allowed[led * most + k] = exists;
        if (!exists) {
            pixel[0] = pixel[1] = NAN;
            spread[0] = spread[3] = 1.0;
            spread[1] = spread[2] = 0.0;
            continue;
        }
        pixel[1] = (spots.centre[2 * k + 1] - matrix[5]) / matrix[4];
        pixel[0] = (spots.centre[2 * k] - matrix[2] - matrix[1] * pixel[1]) / matrix[0];
        undistort(lens, pixel);
        pixel[0] *= matrix[0];
        pixel[1] *= matrix[4];
        copy(spread, spots.noise + 4 * k, 4);
        spread[0] += beside + dragged * merged[k];
        spread[3] += beside + dragged * merged[k];
        if (grey)
            continue;
        int hue = hue_of(spots.colour + 3 * k);
        bool any_hue = spots.saturated[k] && hue == WHITE;
        for (int64_t led = 0; led < n_leds; led++)
            allowed[led * most + k] = light[led] == ANY || light[led] == hue || any_hue;
    }
}

/* Prepare both images' spots: arrays as above with one axis more, (2, ...), left and right. `skew`,
 * px^2: what the right image's spots have in addition to the variance `beside` the noise. */
int64_t entry_prepare_images(
    int64_t n_left, const double *left_centre, const double *left_noise, const bool *left_merged,
    const bool *left_saturated, const double *left_colour, int64_t n_right,
    const double *right_centre, const double *right_noise, const bool *right_merged,
    const bool *right_saturated, const double *right_colour, const double *matrix,
    const double *lens, double beside, double dragged, double skew, int64_t n_leds,
    const int64_t *light, int64_t most, double *pixels, double *covariance, bool *merged,
    bool *allowed)
{
    ImageSpots spots[2] = {
        {n_left, left_centre, left_noise, left_merged, left_saturated, left_colour},
        {n_right, right_centre, right_noise, right_merged, right_saturated, right_colour}};
    for (int side = 0; side < 2; side++)
        prepare_image(spots[side], matrix + 9 * side, lens + 5 * side, beside + side * skew,
                      dragged, n_leds, light, most, pixels + side * most * 2,
                      covariance + side * most * 4, merged + side * most,
                      allowed + side * n_leds * most);
    return 0;
}
