"""Which spot is which LED, in both images at once.

Geometry first: points where two rays nearly meet, as far apart as the marker's LEDs are. What
geometry leaves open (a symmetric marker, two LEDs that could change places) is settled by colour,
then by continuity with the previous pair, then by the candidate nearest to the encoders' pose. The
encoders choose, their value enters nothing.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from verify.identification.hypotheses import Hypotheses, conflicts, departure, lone, score, unique
from verify.identification.search import search, track
from verify.identification.views import Views, look
from verify.marker import Marker
from verify.records import Array, Spots
from verify.rig import Rig

__all__ = ["Identification", "Prediction", "identify"]

CLEARLY = 9.0  # of twice the log evidence: odds of 90 to 1, on noise allowed for generously
BOUND = 2.0  # standard deviations to how far a prediction may be off
JUMP = 50.0  # what a pose far from the prediction costs: two LED images and a half
BELIEVED = 3.0  # departures beyond which a reference says nothing about a pose
APART = 1.0  # by how many departures the nearest must be nearer than the next
ENCODERS_POSITION = 0.07  # m, how far a faulty arm and a clock not yet known may be believed to err
ENCODERS_ROTATION = 0.2  # rad, likewise; marker symmetries lie above 1 rad


@dataclass(frozen=True, slots=True)
class Prediction:
    """Where the chain expects the flange, from the pairs before.

    How far it may be off is taken as two standard deviations; a jump beyond is still found.
    """

    rig_T_flange: Array  # (4, 4), at this pair's left instant
    position_uncertainty: float  # m, how far it may be off
    rotation_uncertainty: float  # rad


@dataclass(frozen=True, slots=True)
class Identification:
    """Which spot is which LED, and how that was settled."""

    left_led: NDArray[np.int64]  # (m,), index into marker.leds
    left_spot: NDArray[np.int64]  # (m,), index into the left spots
    right_led: NDArray[np.int64]  # (k,)
    right_spot: NDArray[np.int64]  # (k,)
    rig_T_flange: Array | None  # (4, 4), coarse; a turn the LEDs leave open is the reference's
    choice: str  # geometry, colour, continuity, encoders; "" where nothing was identified
    alternatives: int  # other assignments that geometry and colour explain as well
    status: str  # measured, too_few_leds, ambiguous_leds


def nothing_expected() -> Sequence[Array]:
    """Stand in for encoders where there are none."""
    return ()


def identify(
    left: Spots,
    right: Spots,
    rig: Rig,
    pan_left: float,
    pan_right: float,
    marker: Marker,
    *,
    prediction: Prediction | None = None,
    expected: Callable[[], Sequence[Array]] = nothing_expected,
    motion_tolerance_px: float = 2.0,
) -> Identification:
    """Find which spot is which LED.

    Args:
        left: spots of the left image, brightest first.
        right: spots of the right image.
        rig: the calibrated cameras.
        pan_left: rad, reading of the left base.
        pan_right: rad, reading of the right base.
        marker: the LEDs, one to six in any arrangement.
        prediction: from the previous pairs; settles what geometry and colour leave open, and
            finds LEDs where too few are seen for geometry alone.
        expected: gives rig_T_flange (4, 4) from the encoders; the nearest settles what is still
            open, and nothing else. Asked only then, and where nothing is predicted.
        motion_tolerance_px: px, how far LEDs may have moved between the two exposures.

    Returns:
        The assignment. Where several explain the spots equally it is empty, `ambiguous_leds`;
        where none does, `too_few_leds`. An LED seen by one camera only is listed for that one.
    """
    if len(left) == 0 or len(right) == 0:
        return _nothing("too_few_leds")
    views = look((left, right), rig, (pan_left, pan_right), marker, motion_tolerance_px)
    found = _find(views, prediction, expected)
    if len(found) == 0:
        return _nothing("too_few_leds")
    evidence = score(views, found)
    informed = evidence.copy()
    if prediction is not None:
        off = _off(views, found, prediction)
        informed += np.minimum(off**2, JUMP)
    best = int(np.argmin(informed))
    rivals = conflicts(found, best) & (evidence < evidence[best] + CLEARLY)
    alternatives = int(rivals.sum())
    rivals &= informed < informed[best] + CLEARLY
    if alternatives == 0 and lone(found)[best]:
        choice = "continuity"
    elif alternatives == 0:
        choice = "colour" if _colour_decided(views, found, best) else "geometry"
    elif not rivals.any():
        choice = "continuity"
    else:
        choice = "encoders"
        open_ones = np.flatnonzero(rivals | (np.arange(len(found)) == best))
        nearest = _nearest(views, found.take(open_ones), expected())
        if nearest is None:
            return _nothing("ambiguous_leds", alternatives)
        best = int(open_ones[nearest])
    return _report(found, best, choice, alternatives)


def _find(
    views: Views, prediction: Prediction | None, expected: Callable[[], Sequence[Array]]
) -> Hypotheses:
    """Search the images, and follow the prediction where there is one."""
    references = [prediction.rig_T_flange] if prediction is not None else expected()
    rig_R_flange = references[0][:3, :3] if len(references) else np.eye(3)
    found = search(views, rig_R_flange, single=prediction is not None)
    if prediction is not None:
        near = _off(views, found, prediction) <= BELIEVED
        there = found if near.all() else found.take(near)
        tracked = track(views, there, prediction.rig_T_flange, *_sizes(prediction))
        found = unique(found.join(tracked))
    stray = lone(found)
    if not stray.any():
        return found
    if prediction is not None:
        stray &= _off(views, found, prediction) > BELIEVED
    return found.take(~stray)


def _off(views: Views, found: Hypotheses, prediction: Prediction) -> Array:
    """Departures of hypotheses (h,) from a prediction, in its standard deviations."""
    return departure(views, found, prediction.rig_T_flange, *_sizes(prediction))


def _sizes(prediction: Prediction) -> tuple[float, float]:
    """Standard deviations of a prediction, m and rad."""
    return prediction.position_uncertainty / BOUND, prediction.rotation_uncertainty / BOUND


def _nearest(views: Views, found: Hypotheses, expected_poses: Sequence[Array]) -> int | None:
    """Choose the hypothesis nearest to an encoders' pose, if one is near and clearly nearest."""
    if len(expected_poses) == 0:
        return None
    scales = ENCODERS_POSITION, ENCODERS_ROTATION
    off = np.min([departure(views, found, pose, *scales) for pose in expected_poses], axis=0)
    best = int(np.argmin(off))
    others = np.delete(off, best)
    clear = off[best] <= BELIEVED and np.all(others >= off[best] + APART)
    return best if clear else None


def _colour_decided(views: Views, found: Hypotheses, best: int) -> bool:
    """Say whether the same search, colour-blind, would have left a rival to the one found."""
    everything = np.repeat(np.isfinite(views.pixels[:, None, :, 0]), len(views.leds), axis=1)
    if np.array_equal(views.allowed, everything):
        return False
    chosen = found.take(np.array([best]))
    blind = replace(views, allowed=everything)
    pool = chosen.join(search(blind, chosen.rotation[0], single=True))
    evidence = score(blind, pool)
    return bool(np.any(conflicts(pool, 0) & (evidence < evidence[0] + CLEARLY)))


def _report(found: Hypotheses, best: int, choice: str, alternatives: int) -> Identification:
    rig_T_flange = np.eye(4)
    rig_T_flange[:3, :3] = found.rotation[best]
    rig_T_flange[:3, 3] = found.position[best]
    left_led, right_led = (np.flatnonzero(side >= 0) for side in found.spot[best])
    return Identification(
        left_led=left_led,
        left_spot=found.spot[best, 0, left_led],
        right_led=right_led,
        right_spot=found.spot[best, 1, right_led],
        rig_T_flange=rig_T_flange,
        choice=choice,
        alternatives=alternatives,
        status="measured",
    )


def _nothing(status: str, alternatives: int = 0) -> Identification:
    none = np.zeros(0, dtype=np.int64)
    return Identification(none, none, none, none, None, "", alternatives, status)
