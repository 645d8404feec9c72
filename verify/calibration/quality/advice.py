"""Sentences on a calibration: doubts, gaps in the coverage, and what improves it most."""

from collections.abc import Collection, Iterator, Mapping, Sequence

import numpy as np

from reports.document.formatting import join_words
from verify.calibration.quality.coverage import ImageCoverage
from verify.calibration.quality.quality import (
    NOISE_GROUP,
    READINGS_GROUP,
    CalibrationQuality,
    PrincipalPoint,
    ViewQuality,
)
from verify.calibration.stereo.records import Calibration
from verify.core.records import SIDES

MIN_REGION_SHARE = 0.15  # of the mean over the regions: fewer corners than that are hardly any
MIN_RADIUS_SHARE = 0.8  # of half the diagonal
MAX_EDGE_GAP = 0.12  # of the image's size: an edge farther from every corner is not covered
EDGES = ("left", "upper", "right", "lower")
MIN_DEPTH_RATIO = 1.4  # farthest over nearest board
MIN_TILT = np.deg2rad(20)  # about either axis; below it focal length and distance are confounded
MIN_TILT_OTHER_SIDE = np.deg2rad(8)  # in the other sense
MIN_PAIRS = 10
MAX_MOTION = 2.5  # standard deviations of all pairs' motions, in space: 1 in 10 by chance
MAX_MOTION_POOR = 1.5  # likewise, where a view of the pair stands out: that much explains it
MIN_MOTION = 1e-6  # m
MAX_FOCAL_SIGMA = 0.01  # of the focal length: 6 mm at 0.6 m
MAX_SQUARE_SIGMA = 3.0  # standard uncertainties between the triangulated and the stated square
ROW_NAMES, COLUMN_NAMES = ("upper", "middle", "lower"), ("left", "middle", "right")
ADVICE = {
    "focal lengths": "add boards tilted by 30° to 45° both ways, at several distances",
    "principal points": "add boards tilted both ways, some of them turned by 90° in their plane",
    "lens distortion": "add boards that reach into the corners of both images",
    "cameras' turns": "add pairs in which both cameras see the whole board, all over the field",
    "cameras' places": "add pairs at more distances, with a board as large as both images hold",
    "pan axes and zeros": "add pairs at more pan angles, over the whole range that is used",
    READINGS_GROUP: "read the pan angles more finely, or lock the bases and calibrate them locked",
    NOISE_GROUP: "use brighter or larger LEDs, a wider baseline, or means over several pairs",
}


def calibration_doubts(
    calibration: Calibration, quality: CalibrationQuality, names: Mapping[int, str] | None = None
) -> tuple[str, ...]:
    """List what speaks against the calibration, a sentence each.

    The names are of the pairs' pictures, by frame, as the user knows them.
    """
    return (
        *_views(quality.views, calibration, names or {}),
        *_focal_lengths(calibration),
        *(sentence for p in quality.principal_points for sentence in _principal_point(p)),
        *_square(calibration),
    )


def coverage_gaps(calibration: Calibration, quality: CalibrationQuality) -> tuple[str, ...]:
    """List the parts of the image, distances and tilts that are missing, a sentence each."""
    count, orientations = len(calibration.frames), quality.orientations
    few = f"Only {count} pairs were used: take {2 * MIN_PAIRS} or more."
    return (
        *([few] if count < MIN_PAIRS else []),
        *(sentence for c in quality.coverage for sentence in _image(c)),
        *_distance([s.distance for s in orientations]),
        *_tilt("horizontal", [s.about_horizontal for s in orientations], ("upper", "lower")),
        *_tilt("vertical", [s.about_vertical for s in orientations], ("right", "left")),
    )


def _views(
    views: Sequence[ViewQuality], calibration: Calibration, names: Mapping[int, str]
) -> Iterator[str]:
    apart = pairs_apart(calibration, {view.frame for view in views if view.poor})
    for frame in apart:
        name = f" ({names[frame]})" if frame in names else ""
        yield (
            f"Pair {frame}{name} was not taken together: left and right are off opposite ways, as "
            "the board moved between them. Leave it out or take it again with the board at rest."
        )
    for view in views:
        if view.poor and view.frame not in apart:
            name = f" ({names[view.frame]})" if view.frame in names else ""
            usual = np.median([v.rms for v in views if v.camera == view.camera])
            yield (
                f"Pair {view.frame}{name} hurts in the {SIDES[view.camera]} camera: rms "
                f"{view.rms:.2f} px, where {usual:.2f} px is usual. Look at its picture "
                "for blur or a covered board; leave it out or take it again."
            )


def pairs_apart(calibration: Calibration, poor: Collection[int]) -> list[int]:
    """Frames of the pairs between whose pictures the board moved more than it usually did.

    Pairs in `poor` have a view that stands out: less motion counts there.
    """
    motion = calibration.motion
    if motion is None:
        return []
    scaled = np.linalg.norm(motion / np.maximum(motion.std(axis=0), MIN_MOTION), axis=1)
    limits = [MAX_MOTION_POOR if f in poor else MAX_MOTION for f in calibration.frames.tolist()]
    return [int(f) for f in calibration.frames[scaled > limits]]


def _image(covered: ImageCoverage) -> Iterator[str]:
    side = SIDES[covered.camera]
    few = MIN_REGION_SHARE * covered.regions.mean()
    for word, chosen in (
        ("No corner", covered.regions == 0),
        ("Hardly a corner", (covered.regions > 0) & (covered.regions < few)),
    ):
        if chosen.any():
            names = [region_name(row, column) for row, column in np.argwhere(chosen).tolist()]
            yield (
                f"{word} lies in the {join_words(names)} of the {side} image: the lens is "
                "extrapolated there. Hold the board there."
            )
    bare = [
        f"{edge} edge ({100 * margin:.0f} % bare)"
        for edge, margin in zip(EDGES, covered.margins.tolist(), strict=True)
        if margin > MAX_EDGE_GAP
    ]
    if bare and covered.regions.any():
        yield (
            f"No corner comes near the {join_words(bare)} of the {side} image: the lens "
            "distortion is extrapolated there. Let the board reach into it."
        )
    elif 0 < covered.reach < MIN_RADIUS_SHARE:
        yield (
            f"In the {side} image no corner lies farther than {100 * covered.reach:.0f} % of the "
            "way to the image's corners: the lens distortion is not determined beyond. Let the "
            "board reach into them."
        )


def region_name(row: int, column: int) -> str:
    """Name one of an image's nine regions."""
    if row == 1 and column == 1:
        return "middle"
    if row == 1:
        return f"{COLUMN_NAMES[column]} edge"
    return f"{ROW_NAMES[row]} {COLUMN_NAMES[column]}"


def _distance(distances: Sequence[float]) -> Iterator[str]:
    near, far = min(distances), max(distances)
    if far >= MIN_DEPTH_RATIO * near:
        return
    middle = (near + far) / 2
    yield (
        f"All boards stood between {near:.2f} m and {far:.2f} m, which determines the focal "
        f"lengths poorly: add some at {0.75 * middle:.2f} m or nearer and some at "
        f"{1.3 * middle:.2f} m or farther."
    )


def _tilt(axis: str, angles: Sequence[float], edges: tuple[str, str]) -> Iterator[str]:
    """Judge the tilts about one axis; a positive one brings the first edge nearer."""
    most = max(abs(a) for a in angles)
    if most < MIN_TILT:
        yield (
            f"Boards were never tilted about the {axis} axis by more than "
            f"{np.rad2deg(most):.0f}°: tilt some by 30° to 45°, either way."
        )
        return
    for sign, edge in ((1, edges[0]), (-1, edges[1])):
        if max(sign * a for a in angles) < MIN_TILT_OTHER_SIDE:
            yield (
                f"No board was tilted about the {axis} axis with its {edge} edge nearer: "
                "tilt some that way by 30° to 45°."
            )


def _principal_point(point: PrincipalPoint) -> Iterator[str]:
    if not point.odd or point.believed:
        return
    where = f"The {SIDES[point.camera]} camera's principal point lies {point.distance:.0f} px off"
    if point.uncertainty is None:
        yield f"{where} the image's centre, and its uncertainty is not known: do not rely on it."
        return
    times = point.distance / point.uncertainty
    yield (
        f"{where} the image's centre, but only {times:.1f} times its standard uncertainty, with "
        f"U = {2 * point.uncertainty:.1f} px (k = 2): do not rely on it. "
        "Add boards tilted both ways."
    )


def _focal_lengths(calibration: Calibration) -> Iterator[str]:
    covariance = calibration.rig.covariance
    if covariance is None:
        return
    u = covariance.by_name
    for side, camera in zip(SIDES, (calibration.rig.left, calibration.rig.right), strict=True):
        share = u.get(f"{side}.fx_px", 0.0) / camera.matrix[0, 0]
        if share > MAX_FOCAL_SIGMA:
            yield (
                f"The {side} camera's focal length, and with it every distance, is known to "
                f"± {2 * share:.1%} only (k = 2), which every joint's uncertainty carries: "
                f"{ADVICE['focal lengths']}."
            )


def _square(calibration: Calibration) -> Iterator[str]:
    found, u, _ = calibration.square_found
    stated = calibration.board.square
    both = float(np.hypot(u, calibration.board.square_standard_uncertainty or 0.0))
    if both == 0 or not abs(found - stated) > MAX_SQUARE_SIGMA * both:  # NaN: not determined
        return
    yield (
        f"Squares come out as {found * 1e3:.3f} mm where {stated * 1e3:.3f} mm are stated, "
        f"{abs(found - stated) / both:.0f} times the uncertainty: the pairs contradict each "
        "other. Check that left and right were taken at one instant, and that no camera moved."
    )
