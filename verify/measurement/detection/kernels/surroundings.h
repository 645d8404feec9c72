/* Say how far the room would move centres, by patches of it beside the spots.
 *
 * A spot's weights, on the pixels of such a patch, give the shift of its centre by that room. Their
 * planes are left out: the spot's own plane is among its parameters, held by its own surroundings.
 * Spots differ in size, and with it in what texture of one grain does to them, so each spot's weights
 * are laid on the patches beside its neighbours too. The mean square of these responses, of the lower
 * three quarters, over what noise and curvature explain is the spot's excess; its own patches' mean
 * square is where that is MAX_OWN times as much.
 */
#ifndef VERIFY_SURROUNDINGS_H
#define VERIFY_SURROUNDINGS_H

#include "verify/measurement/detection/kernels/patches.h"

#define N_AROUND 8 /* patches of the room about each spot, two radii away */
#define N_PLACES 4 /* spots, the own one among them, whose surroundings tell what moves one */
#define N_BESIDE (N_PLACES * N_AROUND)

/* The room that a picture shows. */
typedef struct {
    const Picture *picture;
    int64_t n;            /* lights in it */
    const double *lights; /* (n, 4): their places and half widths, px, and contrasts, DN */
    double noise_left;    /* share of an even room's noise that the picture's format leaves */
} Surroundings;

/* What the room would do to a spot's centre. */
typedef struct {
    float *weight;       /* (2, p), px/DN, by how much each pixel moves it; NULL of one left alone */
    double explained[2]; /* px^2, of the squares of that, by noise and curvature */
    double moved[N_BESIDE][2]; /* px, by patches of the room; NaN where there is none */
    bool dim[N_BESIDE];        /* which of them a dim light reaches */
} Response;

/* Fill in by how much, of what is explained, the variance of m spots exceeds it, `excess` (m,).
 *
 * `kept` (m,), of the fits; `responses` (m,), weight and explained given, the rest is filled in. */
void find_excess(const Surroundings *around, const Fits *fits, int64_t m, const int64_t *kept,
                 Response *responses, double *excess);

#endif
