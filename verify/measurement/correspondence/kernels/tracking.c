/* Follow a predicted pose to the spots of both images, where these show every LED and nothing else
 * that may be one; gather them as LEDs, each at its own instant.
 *
 * Of spots a place that is hardly known, or a light far dimmer than any LED's, is none. */
#include "verify/core/kernels/linear_algebra.h"
#include "verify/core/kernels/scratch.h"
#include "verify/measurement/correspondence/kernels/spots.h"
#include "verify/measurement/correspondence/kernels/views.h"

typedef struct { /* one image's m spots, and when it was taken */
    ImageSpots spots;
    const double *peak, *diameter; /* (m,), DN; (m,), px */
    double least_peak;             /* DN, of an LED; NaN: not known */
    double t, middle, line_time;   /* s, instant of the row `middle`, px; s a row */
} Picture;

typedef struct { /* both images' LEDs, n of the left one, n of the right one */
    double *pose;                 /* (4, 4), rig_T_flange */
    int64_t *spot;                /* (2, n), of each LED, among the likely ones */
    double *centre, *covariance;  /* (2 n, 2), px; (2 n, 2, 2), px^2 */
    double *peak, *taken, *depth; /* (2 n,), DN, s, m along the optical axis */
    double *width;                /* (2 n,), px */
} Tracked;

/* List the spots (n,) that may be LEDs; false where they are not n, or one is merged. `vague`, px^2:
 * variance along an axis beyond which a place is hardly known. */
static bool list_likely(const Picture *from, double vague, int64_t n, int64_t *likely)
{
    int64_t count = 0;
    for (int64_t k = 0; k < from->spots.count; k++) {
        const double *noise = from->spots.noise + 4 * k;
        if (!(noise[0] <= vague && noise[3] <= vague) || from->peak[k] < from->least_peak)
            continue;
        if (count == n || from->spots.merged[k])
            return false;
        likely[count++] = k;
    }
    return count == n;
}

/* Copy the spots that are listed (n,). */
static ImageSpots gather(ImageSpots from, int64_t n, const int64_t *listed)
{
    double *centre = TAKE(double, 2 * n), *noise = TAKE(double, 4 * n);
    double *colour = TAKE(double, 3 * n);
    bool *merged = TAKE(bool, n), *saturated = TAKE(bool, n);
    for (int64_t k = 0; k < n; k++) {
        copy(centre + 2 * k, from.centre + 2 * listed[k], 2);
        copy(noise + 4 * k, from.noise + 4 * listed[k], 4);
        copy(colour + 3 * k, from.colour + 3 * listed[k], 3);
        merged[k] = from.merged[listed[k]];
        saturated[k] = from.saturated[listed[k]];
    }
    return (ImageSpots){n, centre, noise, merged, saturated, colour};
}

/* Fill in one image's LEDs at a pose, `side` 0 for the left one. */
static void fill_side(const Scene *scene, int side, const Picture *from, ImageSpots spots,
                      const int64_t *likely, Tracked to)
{
    int64_t n = scene->n_leds;
    const double *ahead = scene->camera_R_rig + 9 * side + 6, *eye = scene->center + 3 * side;
    for (int64_t led = 0, row = n * side; led < n; led++, row++) {
        int64_t k = to.spot[row];
        double placed[3];
        place_point(to.pose, scene->leds + 3 * led, placed);
        copy(to.centre + 2 * row, spots.centre + 2 * k, 2);
        copy(to.covariance + 4 * row, spots.noise + 4 * k, 4);
        to.peak[row] = from->peak[likely[k]];
        to.width[row] = from->diameter[likely[k]];
        to.taken[row] = from->t + (spots.centre[2 * k + 1] - from->middle) * from->line_time;
        to.depth[row] = 0.0;
        for (int i = 0; i < 3; i++)
            to.depth[row] += ahead[i] * (placed[i] - eye[i]);
    }
}

/* Follow a pose (4, 4) whose standard uncertainty, m and rad, and that of the shift, px, are
 * `sigmas` (3,). Gives 1; or 0 where not every LED has a spot and every spot is one, or where the
 * fit's chi^2 reaches `most_chi2`.
 *
 * `scene`: all but its spots, of which both images have as many as there are LEDs; `lenses`: camera
 * matrices (2, 3, 3), px, and lenses (2, 5); `variance` (2,), px^2, of either image's spots beside
 * their noise; `vague` as in `list_likely`; `bounds` as in `follow_alone`. */
static int64_t track_leds(const Picture *pictures, double vague, Scene scene,
                          const double *const *lenses, const double *variance,
                          const int64_t *light, const double *pose, const double *sigmas,
                          const double *bounds, double most_chi2, Tracked to)
{
    int64_t n = scene.n_leds, *likely = TAKE(int64_t, 2 * n);
    double *pixels = TAKE(double, 4 * n), *covariance = TAKE(double, 8 * n), state[N_STATE];
    bool *merged = TAKE(bool, 2 * n), *allowed = TAKE(bool, 2 * n * n);
    ImageSpots spots[2];
    for (int side = 0; side < 2; side++) {
        if (!list_likely(pictures + side, vague, n, likely + n * side))
            return 0;
        spots[side] = gather(pictures[side].spots, n, likely + n * side);
        prepare_image(spots[side], lenses[0] + 9 * side, lenses[1] + 5 * side, variance[side], 0.0,
                      n, light, n, pixels + 2 * n * side, covariance + 4 * n * side,
                      merged + n * side, allowed + n * n * side);
    }
    scene.pixels = pixels, scene.covariance = covariance;
    scene.merged = merged, scene.allowed = allowed;
    if (!follow_alone(&scene, pose, sigmas, bounds, state, to.spot) || !(state[CHI2] < most_chi2))
        return 0;
    for (int64_t k = 0; k < 2 * n; k++)
        if (to.spot[k] < 0)
            return 0;
    clear(to.pose, 16);
    for (int i = 0; i < 3; i++) {
        copy(to.pose + 4 * i, state + 3 * i, 3);
        to.pose[4 * i + 3] = state[POSITION + i];
    }
    to.pose[15] = 1.0;
    for (int side = 0; side < 2; side++)
        fill_side(&scene, side, pictures + side, spots[side], likely + n * side, to);
    return 1;
}

/* Arguments as in `Picture`, `Scene`, `track_leds` and `Tracked`; `beside`, px^2, variance beside
 * the noise, and `skew`, that of the right image's spots in addition; `rows` (4, 2 n): peak,
 * instant, depth and width. */
int64_t entry_track_leds(
    int64_t n_left, const double *left_centre, const double *left_noise, const bool *left_merged,
    const bool *left_saturated, const double *left_colour, const double *left_peak,
    const double *left_diameter, double left_least, double left_t, double left_middle,
    double left_line_time, int64_t n_right, const double *right_centre, const double *right_noise,
    const bool *right_merged, const bool *right_saturated, const double *right_colour,
    const double *right_peak, const double *right_diameter, double right_least, double right_t,
    double right_middle, double right_line_time, double vague, const double *matrix,
    const double *lens, const double *camera_R_rig, const double *center, const double *focal,
    double beside, double skew, int64_t n_leds, const double *leds, const int64_t *light,
    double nearest, double play, double shift_weight, const double *rig_T_flange, double position,
    double turn, double shift, const double *bounds, double most_chi2, double *pose, int64_t *spot,
    double *centre, double *covariance, double *rows)
{
    Picture pictures[2] = {
        {{n_left, left_centre, left_noise, left_merged, left_saturated, left_colour}, left_peak,
         left_diameter, left_least, left_t, left_middle, left_line_time},
        {{n_right, right_centre, right_noise, right_merged, right_saturated, right_colour},
         right_peak, right_diameter, right_least, right_t, right_middle, right_line_time}};
    Scene scene = {.camera_R_rig = camera_R_rig, .center = center, .focal = focal,
                   .n_spots = n_leds, .n_leds = n_leds, .leds = leds, .nearest = nearest,
                   .play = play, .shift_weight = shift_weight};
    int64_t m = 2 * n_leds;
    Tracked to = {pose, spot, centre, covariance, rows, rows + m, rows + 2 * m, rows + 3 * m};
    GUARDED(track_leds(pictures, vague, scene, (const double *[]){matrix, lens},
                       (double[]){beside, beside + skew}, light, rig_T_flange,
                       (double[]){position, turn, shift}, bounds, most_chi2, to));
}
