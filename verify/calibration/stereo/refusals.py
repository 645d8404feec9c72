"""Refuse pictures that determine no rig: what is missing, and how to get it."""

from collections.abc import Sequence

import numpy as np

from verify.calibration.stereo.estimate import Estimate
from verify.calibration.stereo.parameters import PAR_FOCAL, PAR_PRINCIPAL, camera_columns
from verify.calibration.stereo.start import CameraRelation
from verify.core.fiducials import BoardPair
from verify.core.records import SIDES, Array
from verify.errors import InputError
from verify.io.toml import listed

MIN_PAIRS = 3
MIN_NORMAL_SPREAD = np.deg2rad(6.0)  # boards whose normals spread by less are parallel
# up to what share of the focal length a stated uncertainty holds, by the spread from which on:
# small tilts are uncertain themselves, and then it is too small (simulated, rms z is 1.5 to 2)
MAX_FOCAL_UNCERTAINTY = {0.0: 0.01, MIN_NORMAL_SPREAD: 0.05, np.deg2rad(10.0): 0.1}
MAX_NAMED_PAIRS = 8  # pairs that a message lists
SAME_PLACE = np.deg2rad(1.0)  # boards that are turned and, from the camera, moved by less
MAX_PAN_SCATTER = np.deg2rad(2.0)  # scatter of readings beyond which they are no readings
MIN_READINGS = 8  # by which a scale is told from scatter
MAX_UNEXPLAINED = 0.2  # of the squared errors, that a scale leaves
MIN_SLOPE = 0.02  # of errors over readings: less is a base's own
MIN_BESIDE, MAX_BESIDE = 5, 0.05  # pairs on either side of a change; variance that it leaves
MIN_SQUARE = 1e-12  # rad²: a base that did not turn
MORE_PICTURES = (
    "Move the board through the whole picture, near and far, tilted 20 to 40° every way."
)


def refuse_unseen(pairs: Sequence[BoardPair], left_out: str = "") -> None:
    """Raise InputError where too few pairs show the board in a camera, or in both at once.

    `left_out`: a sentence on pairs that would have been usable.
    """
    views = [[p.left is not None for p in pairs], [p.right is not None for p in pairs]]
    counts, both = [sum(own) for own in views], sum(map(all, zip(*views, strict=True)))
    expected = "the board's inner corners are looked for"
    remedy = "Check the pattern's columns and rows, and that the whole board is in view and sharp."
    if pairs and not any(counts):
        raise InputError("pairs", f"show no board in any of {len(pairs)}", expected, remedy)
    for side, count in zip(SIDES, counts, strict=True):
        if pairs and not count:
            found = f"shows no board in any of {len(pairs)} pictures"
            raise InputError(side, found, expected, remedy)
    if both < MIN_PAIRS:
        found = f"show the board in both cameras {both} time{'' if both == 1 else 's'}"
        remedy = f"{left_out} {MORE_PICTURES}".strip()
        raise InputError("pairs", found, "three are the fewest, ten to twenty are good", remedy)


def refuse_one_place(poses: Sequence[dict[int, Array]]) -> None:
    """Raise InputError where every picture of either camera shows the board at the same place.

    What all of them share (a lens's bend, a bow) then passes for the focal length, many times over.
    """
    for own in poses:
        boards = np.array(list(own.values()))
        turns = np.einsum("ij,bij->b", boards[0, :3, :3], boards[:, :3, :3])
        apart = np.linalg.norm(boards[:, :3, 3] - boards[0, :3, 3], axis=1)
        turned = np.any(turns < 1 + 2 * np.cos(SAME_PLACE))
        if turned or np.any(apart > SAME_PLACE * boards[0, 2, 3]):
            return
    found = "show the board at one and the same place, all of them"
    raise InputError("pairs", found, "three places are the fewest", MORE_PICTURES)


def refuse_half_turned(
    relation: CameraRelation, poses: Sequence[dict[int, Array]], frames: Sequence[int]
) -> None:
    """Raise InputError for pairs whose board one camera numbered from its other end.

    It names the pairs, and the camera where the board looks upside down in one only.
    """
    if not relation.half_turned:
        return
    inverted = [sum(bool(own[i][0, 0] < 0) for i in relation.half_turned) for own in poses]
    place = "pairs" if inverted[0] == inverted[1] else SIDES[int(inverted[1] > inverted[0])]
    which = list_pairs([frames[i] for i in relation.half_turned])
    found = f"sees the board turned by 180° in {which}, against the other camera"
    if place == "pairs":
        found = f"show the board turned by 180° in one camera, in {which}"
    remedy = (
        "Hold the board the right way up in both pictures, or leave these pairs out; a board with "
        "an odd and an even count of corners cannot be mistaken."
    )
    raise InputError(place, found, "both cameras must number its corners from the same end", remedy)


def refuse_swapped(relation: CameraRelation) -> None:
    """Raise InputError where the right camera stands to the left of the left one."""
    x = float(relation.left_T_right[0, 3])
    if x < 0:
        found = f"is the camera on the right: the other stands some {-100 * x:.0f} cm to its left"
        expected = "left is the left one as seen from behind the cameras"
        remedy = "Swap the two folders or videos, and the pan columns with them."
        raise InputError("left", found, expected, remedy)


def refuse_inconsistent(
    relation: CameraRelation, pairs: int, turned: bool, four_fold: bool
) -> None:
    """Raise InputError where half of the pairs or more disagree how the cameras stand.

    `turned`: the bases were, between pairs; `four_fold`: a quarter turn leaves the pattern as it
    is.
    """
    if 2 * len(relation.outliers) < pairs:
        return
    found = f"do not agree how the cameras stand to each other: {len(relation.outliers)} of {pairs}"
    if turned:
        expected = "the pan angles must be those at which the pictures were taken"
        remedy = "Check the pan columns of frames.csv, their signs and their order."
    else:
        expected = "the cameras must stand still, or their pan angles be given"
        remedy = "Check that left and right were taken together; give pan angles in frames.csv."
    if four_fold:
        remedy += (
            " A square board of even counts does not tell a quarter turn: hold it upright in both "
            "cameras, or use one of unequal counts."
        )
    raise InputError("pairs", found, expected, remedy)


def refuse_wrong_readings(scatter: float, readings: Array, errors: Array) -> None:
    """Raise InputError where the bases stand `scatter` (rad, rms) too far off their readings.

    Or where `errors` (b, 2), angles less readings (b, 2), rad, grow with these, which are scaled
    then. By which factor is not said: pictures show the bases' turns against each other best.
    """
    expected = f"± {np.rad2deg(MAX_PAN_SCATTER):.0f}° is the worst"
    apart, turned = errors - errors.mean(axis=0), readings - readings.mean(axis=0)
    slopes = np.sum(apart * turned, axis=0) / np.maximum(np.sum(turned**2, axis=0), MIN_SQUARE)
    left = np.sum((apart - slopes * turned) ** 2, axis=0)
    scaled = (np.abs(slopes) > MIN_SLOPE) & (left < MAX_UNEXPLAINED * np.sum(apart**2, axis=0))
    if scatter <= MAX_PAN_SCATTER:
        if len(readings) < MIN_READINGS or not scaled.any():
            return
        side = int(np.argmax(scaled))
        how = "faster" if slopes[side] < 0 else "more slowly"
        expected = f"pan_{SIDES[side]}_deg grows {how} than its base turns"
    found = f"stand {np.rad2deg(scatter):.1f}° (rms) off the pan angles given"
    remedy = "Check the pan columns of frames.csv: degrees, their signs and their order."
    raise InputError("pairs", found, expected, remedy)


def refuse_changed(motion: Array | None, frames: Sequence[int]) -> None:
    """Raise InputError where the boards' seeming motions (b, 3), m, are two, before a pair and on.

    A hand moves by another amount each time; a lens that focuses anew, or a camera that is touched,
    stays so. None: the pictures show no motion.
    """
    shown = np.zeros((0, 3)) if motion is None else motion
    for k in range(MIN_BESIDE, len(shown) - MIN_BESIDE + 1):
        left = sum(len(part) * part.var(axis=0) for part in (shown[:k], shown[k:]))
        if np.any(left < MAX_BESIDE * len(shown) * shown.var(axis=0)):
            found = f"from about pair {frames[k]} on show another camera or lens than those before"
            remedy = (
                "Switch autofocus off, fix the cameras, and calibrate from pictures of one state."
            )
            raise InputError("pairs", found, "all must be of one rig", remedy)


def refuse_undetermined(found: Estimate) -> None:
    """Refuse boards that leave a focal length or a principal point open in the last adjustment.

    The covariance decides where it can be believed; the boards' poses word the remedy too.

    Raises:
        InputError: a focal length or principal point known worse than 10 % of the focal length,
            5 % where boards are tilted little, 1 % where all are parallel.
    """
    normals = found.state.boards[:, :3, 2]
    mean = normals.mean(axis=0) / np.linalg.norm(normals.mean(axis=0))
    # of the boards' normals about their mean, rad (rms)
    spread = float(np.sqrt(np.mean(np.arccos(np.clip(normals @ mean, -1, 1)) ** 2)))
    limit = max(share for least, share in MAX_FOCAL_UNCERTAINTY.items() if spread >= least)
    u = np.sqrt(np.maximum(np.diag(found.covariance), 0.0))
    for index, (side, camera) in enumerate(zip(SIDES, found.state.cameras, strict=True)):
        own = u[camera_columns(index)] / camera.matrix[0, 0]
        focal, principal = float(own[PAR_FOCAL].max()), float(own[PAR_PRINCIPAL].max())
        if max(focal, principal) < limit:
            continue
        if focal > limit:
            what, share, of_what = "focal length, and with it every distance,", focal, ""
        else:
            what, share, of_what = "principal point", principal, " of the focal length"
        amount = f"± {share:.0%}{of_what}" if share < 1 else "not at all"
        posture, remedy = _posture_and_remedy(found, spread)
        found_text = f"does not show the {what} well enough ({amount}): {posture}"
        raise InputError(side, found_text, f"± {limit:.0%} would be the worst", remedy)


def _posture_and_remedy(found: Estimate, spread: float) -> tuple[str, str]:
    """Word how little the boards' poses vary, and which poses to add."""
    depth = found.state.boards[:, 2, 3]
    level = np.ptp(depth) < 0.1 * abs(np.mean(depth))
    if spread < MIN_NORMAL_SPREAD:
        posture = "all boards are parallel" + (" and at one distance" if level else "")
        return posture, (
            "Add pairs with the board tilted 20 to 40° about its upright and about its level axis, "
            "both ways."
        )
    if level:
        return "all boards are at one distance", "Add pairs nearer and farther, tilted every way."
    return "the boards' tilts are too few", MORE_PICTURES


def list_pairs(frames: Sequence[int]) -> str:
    """Name pairs, the first few of many."""
    return f"pair{'' if len(frames) == 1 else 's'} {listed(frames, MAX_NAMED_PAIRS)}"
