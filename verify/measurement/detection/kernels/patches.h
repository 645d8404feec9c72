/* Cut the pixels around candidates out of a picture, and keep what is fitted to them. */
#ifndef VERIFY_PATCHES_H
#define VERIFY_PATCHES_H

#include <stdbool.h>
#include <stdint.h>

#include "verify/measurement/detection/kernels/pixels.h"

#define PATCH_REACH 2.4  /* half-widths: a Gaussian has fallen to 1/50 there, a disc is long over */
#define PATCH_MARGIN 2.5 /* px of floor around that */
#define SLOPE_REACH 2.3  /* half-widths: what is farther out by a pixel shows the floor's slope */
/* sums of half-widths between two spots, of which one's light reaches the other's pixels */
#define MIN_APART 1.2
#define MAX_APART 4.0

/* A picture's pixels, (height, width, channels), DN. */
typedef struct {
    const uint8_t *values;
    int64_t width, height, channels;
} Picture;

/* What is fitted to n spots' pixels. */
typedef struct {
    int64_t n;
    int64_t *origin;     /* (n, 2), px, of each patch's centre pixel */
    int64_t *radius;     /* (n,), of each patch, in steps between its pixels */
    double *scale;       /* (n,), px, half-width that the fit starts from */
    double *weight;      /* (n, 3), of the channels, by which they are combined; (1, 0, 0) of one */
    double *share;       /* (n, 2), by which combining colours changes a channel's read variance, gain */
    double *colour;      /* (n, 3), DN, mean B, G, R above the surroundings */
    double *level;       /* (n,), DN, that three tenths of the pixels stay below */
    int64_t *pixels;     /* (n,), how many each spot has */
    int64_t *begin;      /* (n + 1,), where each spot's begin in an array of them all, rows padded */
    float *pool;         /* rows (25, p) of each spot's pixels, one spot behind the other */
    double *prior;       /* (n, 2, 10), mean and inverse variance of the parameters */
    bool *saturated;     /* (n,), whether some pixels on the spot are at the sensor's limit */
    bool *settled;       /* (n,), whether a further step would gain nothing that counts */
    double *parameters;  /* (n, 10), x and y in px from the patch's centre pixel */
    double *information; /* (n, 10, 10), inverse covariance, priors included */
    double *gradient;    /* (n, 10), of the quasi-likelihood */
    double *root;        /* (n, 10, 10), Cholesky factor of the information, once it is assessed */
    double *chi2;        /* (n,) */
} Fits;

/* How many pixels a spot has, and their rows (25, p). */
static inline int64_t pixels_of(const Fits *fits, int64_t n)
{
    return fits->pixels[n];
}

static inline float *rows_of(const Fits *fits, int64_t n)
{
    return fits->pool + N_ROWS * fits->begin[n];
}

/* Cut out the pixels around n spots; for a first look some 200 each, spread over its size.
 *
 * `spots` (n, 4): centre, column and row, px; half width, px; contrast, DN. The arrays are scratch. */
Fits cut_patches(const Picture *picture, int64_t n, const double *spots, bool first_look);

/* Which of counted whole numbers, from 0 on, has a rank, from 0. */
int64_t ranked(const int32_t *counts, int64_t rank);

#endif
