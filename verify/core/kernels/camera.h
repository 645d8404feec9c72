/* OpenCV's lens: k1, k2, p1, p2, k3 (5,) bend a ray (x, y, 1), in the camera's axes, to another. */
#ifndef VERIFY_CAMERA_H
#define VERIFY_CAMERA_H

typedef struct {
    double x, y;
    double xx, xy, yy; /* their derivatives by the ray, which are symmetric */
} Bent;

static inline Bent bend(const double *lens, double x, double y)
{
    double k1 = lens[0], k2 = lens[1], p1 = lens[2], p2 = lens[3], k3 = lens[4];
    double r2 = x * x + y * y, higher = r2 * k3 + k2;
    double straight = 1.0 + r2 * (k1 + r2 * higher) + 2.0 * (p1 * y + p2 * x);
    double slope = 2.0 * (k1 + r2 * (higher + higher + r2 * k3)); /* 2 d radial / d r2 */
    return (Bent){
        x * straight + p2 * r2,
        y * straight + p1 * r2,
        straight + x * x * slope + 4.0 * p2 * x,
        x * y * slope + 2.0 * (p1 * x + p2 * y),
        straight + y * y * slope + 4.0 * p1 * y,
    };
}

/* Fill in the derivatives of the bent ray by the lens. */
static inline void differentiate_lens(double x, double y, double by_lens[5][2])
{
    double r2 = x * x + y * y, ray[2] = {x, y};
    for (int i = 0; i < 2; i++) {
        by_lens[0][i] = r2 * ray[i];
        by_lens[1][i] = r2 * r2 * ray[i];
        by_lens[4][i] = r2 * r2 * r2 * ray[i];
        by_lens[2 + i][1 - i] = r2 + 2.0 * ray[1 - i] * ray[1 - i];
        by_lens[2 + i][i] = 2.0 * x * y;
    }
}

#endif
