"""Entries of the compiled alignment, pose fit and sensitivities."""

import numpy as np

from verify.core.native import entry
from verify.core.records import Array, Flags, Index

# how many of a pair's s spots are the left picture's, which come first; their LED (s,), centre (s,
# 2) px, covariance (s, 2, 2) px², instant (s,) s
SpotView = tuple[int, Index, Array, Array, Array]
# the kept spot that fits worst, its residual in its own uncertainty, squared, and whether the kept
# ones agree as a whole
Judgement = tuple[int, float, bool]
SpotPlaces = tuple[Array, Array, int]  # as `predict_spots` takes them

# As in directions.h and pose.c
LEVER = 0.1  # m, the size of a marker: makes metres and radians comparable
SCALE = np.repeat([LEVER, 1.0], 3)  # m and rad: units in which both are alike
ACCELERATION_PER_SPEED = 3.0  # 1/s, assumed
MOTION_RATE = 3.0  # likewise: of jerk an acceleration, of snap a jerk, 1/s
MIN_ACCELERATION = (0.02, 0.1)  # m/s², rad/s²: a slow arm still starts and stops
# As in sensitivities.c
MIDDLE, FOCAL, LENS, MOTION = range(4)
LED, SHIFT, TURN = range(3)

_align_spots = entry("align_spots")
_led_boxes = entry("led_boxes")
_predict_spots = entry("predict_spots")
_move_pose = entry("move_pose")
_fit_spots = entry("fit_spots")
_fill_by_camera = entry("fill_by_camera")
_fill_derivatives = entry("fill_derivatives")


def align_spots(
    now: SpotView, around: tuple[SpotView, SpotView, SpotView], t: float
) -> tuple[bool, Array, Array, Array, Array]:
    """Carry s spots to an instant t, s, by what neighbouring pairs show of their LEDs.

    LEDs that no neighbour shows move like the others, with their spread as uncertainty. `around`:
    the spots of the pairs before, after, and before the one before, which counts only beside one of
    the others; empty where there is none.

    Gives whether all are aligned: not where spots have to be moved and no neighbour shows how;
    centre (s, 2); covariance (s, 2, 2); velocity (s, 2), px/s; levers (s, 3), s², s³, s⁴.
    """
    s, (one, two, three) = len(now[1]), around
    views = s, *now, len(one[1]), *one, len(two[1]), *two, len(three[1]), *three
    place, spread = np.empty((s, 2)), np.empty((s, 2, 2))
    velocity, lever = np.empty((s, 2)), np.empty((s, 3))
    aligned = _align_spots(*views, t, place, spread, velocity, lever)
    return bool(aligned), place, spread, velocity, lever


def led_boxes(
    camera_T_flange: Array,
    leds: Array,
    camera: tuple[Array, Array],
    half: tuple[float, float, float, float],
    size: tuple[int, int],
) -> Array:
    """Boxes about the LEDs in the image, (n, 4), px: x0, y0, x1, y1; those that overlap become one.

    `camera_T_flange` (4, 4); `leds` (n, 3), m, flange frame; `camera`: its matrix (3, 3), px, and
    k1, k2, p1, p2, k3; `half`: half a box: px; and at the LED's depth, m, m, and rad that the whole
    has turned; `size`, px, width and height of the image.
    """
    boxes = np.empty((len(leds), 4))
    return boxes[: _led_boxes(len(leds), camera_T_flange, leds, *camera, *half, *size, boxes)]


def predict_spots(
    rig_T_flange: Array, points: Array, cameras: Array, left: int
) -> tuple[Array, Array, Array]:
    """Predict s spots' images (s, 2), px, and how they change with the point and with the pose.

    `rig_T_flange` (4, 4); `points` (s, 3), m, LEDs in the flange frame, of which the left camera
    sees the first `left` ones; `cameras` (2, 23), of each camera_T_rig (3, 4), k1, k2, p1, p2, k3,
    and the matrix (2, 3), px. By the point in the rig (s, 2, 3), px/m; by the pose (s, 2, 6), a
    translation and a rotation vector in rig axes.
    """
    n = len(points)
    predicted = np.empty((n, 2)), np.empty((n, 2, 3)), np.empty((n, 2, 6))
    _predict_spots(n, left, rig_T_flange, points, cameras, *predicted)
    return predicted


def move_pose(pose: Array, step: Array) -> None:
    """Move a pose (4, 4) in place by translation and rotation vector (6,)."""
    _move_pose(pose, step)


def fit_spots(
    places: SpotPlaces,
    centre: Array,
    spots: tuple[Array, Array, Array],
    rows: Index,
    pose: Array,
    limits: tuple[Array, Array],
) -> tuple[
    Judgement,
    tuple[Array, Array, Array],
    Array,
    Array,
    tuple[Array, Flags],
    Array,
    tuple[float, float],
    Array,
    tuple[Array, Array, Array, float],
]:
    """Fit a pose (4, 4), rig_T_flange, to s spots by Gauss-Newton; it is changed.

    `places`: what `predict_spots` needs after the pose; `centre` (s, 2), px, as measured; `spots`:
    covariance (s, 2, 2) px², velocity (s, 2) px/s and the levers (s, 3) of acceleration, jerk and
    snap, s², s³, s⁴; `rows` (2 k,), those of the spots that count; `limits`: what
    spots may be off beside their noise, (2 s, 2 s) px², and the greatest chi² (2 s + 1,) that
    noise, motion and this reach, by degrees of freedom.

    Returns:
        The judgement; residual (s, 2) px, and the derivatives of the spots by the point (s, 2, 3)
        and by the pose (s, 2, 6), before the last step; covariance of the spots from the pixels and
        from motion that is not known, (2, 2 s, 2 s); the gain (6, 2 s), d pose / d spot, 0 for
        spots that do not count; the directions of `covariance_of`, (6, 6) and (6,); the twist (6,),
        m/s and rad/s; the acceleration assumed, a component, m/s² and rad/s²; the image
        acceleration of that twist, corrected for, (s, 2), px/s²; the pose's covariances (6, 6) by
        the pixels' noise and by motion that is not known, the spots' uncertainty (s,), px, by both,
        and the residuals' chi².

    Raises:
        numpy.linalg.LinAlgError: a step is not finite.
    """
    n = len(centre)
    predicted = np.empty((n, 2)), np.empty((n, 2, 3)), np.empty((n, 2, 6))
    spread, gain = np.empty((2, 2 * n, 2 * n)), np.empty((6, 2 * n))
    directions, twist, curvature = np.empty((6, 6)), np.empty(6), np.empty((n, 2))
    known, covariances = np.empty(6, np.bool_), np.empty((2, 6, 6))
    uncertainty, figures = np.empty(n), np.empty(4)
    points, cameras, left = places
    given = n, left, points, cameras, centre, *spots, len(rows), rows, *limits, pose
    motion = twist, curvature, covariances, uncertainty, figures
    found = _fit_spots(*given, *predicted, spread, gain, directions, known, *motion) - 1
    if found < 0:
        raise np.linalg.LinAlgError("a step is not finite")
    pixels, alignment = covariances
    linear, angular, chi2, most = figures.tolist()
    return (
        (found // 2, most, bool(found % 2)),
        predicted,
        spread,
        gain,
        (directions, known),
        twist,
        (linear, angular),
        curvature,
        (pixels, alignment, uncertainty, chi2),
    )


def fill_by_camera(
    kinds: Index,
    twists: Array,
    camera: tuple[Array, Array],
    spots: tuple[Array, Array, Array],
    moved: Array,
) -> None:
    """Fill in how one camera's parameters move its s spots.

    `kinds` (k, 3): the parameter's column, what it is, which one of its kind; `twists` (k, 6), how
    it moves the camera: translation at the rig's origin (m) and turn; `camera`: its matrix (3, 3),
    px, and k1, k2, p1, p2, k3; `spots`: points in the camera and the same in the rig, (s, 3), m,
    and d px / d point in the rig, (s, 2, 3); `moved` (p, s, 2), px a SI unit, zeros.
    """
    _fill_by_camera(len(kinds), kinds, twists, *camera, len(spots[0]), *spots, moved)


# of a camera: kinds, twists, matrix and lens as in `fill_by_camera`; camera_T_rig (4, 4)
StatedCamera = tuple[Index, Array, Array, Array, Array]


def fill_derivatives(
    spots: tuple[Array, Index, Array, Array],
    left: int,
    body: Index,
    cameras: tuple[StatedCamera, StatedCamera],
    moved: Array,
) -> None:
    """Fill in how LEDs, the body that holds them, and both cameras' parameters move s spots.

    `spots`: LEDs (n, 3), m, flange frame; of each spot its LED (s,); rig_T_flange (4, 4); d px / d
    point in the rig (s, 2, 3). The left camera sees the first `left`. `body` (k, 4): a parameter's
    column, what it is, its LED, its axis of the flange; `moved` (p, s, 2), px a SI unit, zeros.
    """
    of_cameras = [value for one in cameras for value in (len(one[0]), *one)]
    _fill_derivatives(len(spots[1]), left, *spots, len(body), body, *of_cameras, moved)
