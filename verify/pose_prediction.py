"""Where a pose puts the spots of both images, compiled: the inner loop of `pose.fit_pose`."""

from verify.compiled import compiled
from verify.records import Array


@compiled
def predict_spots(
    rig_T_flange: Array,
    points: Array,
    camera_R_rig: Array,
    origin: Array,
    lens: Array,
    focal: Array,
    middle: Array,
    pixels: Array,
    by_point: Array,
    by_pose: Array,
) -> None:
    """Fill in s spots' images and how they change with the point and with the pose.

    Args:
        rig_T_flange: (4, 4).
        points: (s, 3), m, LEDs in the flange frame.
        camera_R_rig: (s, 3, 3), of each spot's camera.
        origin: (s, 3), m, of the rig in the camera.
        lens: (5, s), k1, k2, p1, p2, k3.
        focal: (s, 2, 2), px, of the camera's matrix.
        middle: (s, 2), px, likewise.
        pixels: (s, 2), filled.
        by_point: (s, 2, 3), px/m, filled: by the point in the rig.
        by_pose: (s, 2, 6), filled: by a translation and a rotation vector in rig axes.
    """
    for s in range(len(points)):
        px, py, pz = points[s, 0], points[s, 1], points[s, 2]
        a = rig_T_flange[0, 0] * px + rig_T_flange[0, 1] * py + rig_T_flange[0, 2] * pz
        b = rig_T_flange[1, 0] * px + rig_T_flange[1, 1] * py + rig_T_flange[1, 2] * pz
        c = rig_T_flange[2, 0] * px + rig_T_flange[2, 1] * py + rig_T_flange[2, 2] * pz
        u, v, w = a + rig_T_flange[0, 3], b + rig_T_flange[1, 3], c + rig_T_flange[2, 3]
        turn = camera_R_rig[s]
        depth = turn[2, 0] * u + turn[2, 1] * v + turn[2, 2] * w + origin[s, 2]
        x = (turn[0, 0] * u + turn[0, 1] * v + turn[0, 2] * w + origin[s, 0]) / depth
        y = (turn[1, 0] * u + turn[1, 1] * v + turn[1, 2] * w + origin[s, 1]) / depth
        k1, k2, p1, p2, k3 = lens[0, s], lens[1, s], lens[2, s], lens[3, s], lens[4, s]
        r2 = x * x + y * y
        higher = r2 * k3 + k2
        radial = 1.0 + r2 * (k1 + r2 * higher)
        slope = 2.0 * (k1 + r2 * (higher + higher + r2 * k3))  # d radial / d r2, times 2
        straight = radial + 2.0 * (p1 * y + p2 * x)
        seen_x, seen_y = x * straight + p2 * r2, y * straight + p1 * r2
        xx = straight + x * x * slope + 4.0 * p2 * x
        xy = x * y * slope + 2.0 * (p1 * x + p2 * y)
        yy = straight + y * y * slope + 4.0 * p1 * y
        for i in range(2):
            f, g = focal[s, i, 0], focal[s, i, 1]
            pixels[s, i] = f * seen_x + g * seen_y + middle[s, i]
            by_x, by_y = (f * xx + g * xy) / depth, (f * xy + g * yy) / depth
            by_depth = -(by_x * x + by_y * y)
            d = by_x * turn[0, 0] + by_y * turn[1, 0] + by_depth * turn[2, 0]
            e = by_x * turn[0, 1] + by_y * turn[1, 1] + by_depth * turn[2, 1]
            h = by_x * turn[0, 2] + by_y * turn[1, 2] + by_depth * turn[2, 2]
            by_point[s, i, 0], by_point[s, i, 1], by_point[s, i, 2] = d, e, h
            by_pose[s, i, 0], by_pose[s, i, 1], by_pose[s, i, 2] = d, e, h
            by_pose[s, i, 3], by_pose[s, i, 4] = h * b - e * c, d * c - h * a
            by_pose[s, i, 5] = e * a - d * b
