"""Does the calibration still hold? Known lengths, measured anywhere in the volume.

Every morning, before anything is judged: the marker's own LED distances, a bar of two LEDs, or a
board. What the check could have seen and what it could not is part of the answer.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from verify.analysis.rig_check import (
    CHANGES,
    FIGURES,
    RigConsistency,
    consistency,
    drop_registration,
    figures_text,
)
from verify.calibration.board_pose import board_marker, board_poses
from verify.calibration.check.lengths import BarTracker, Lengths, measured_lengths
from verify.core.fiducials import Board, BoardPair, Marker
from verify.core.records import Measurement, StereoPair
from verify.core.rig import Rig
from verify.core.statistics import norm_isf, norm_ppf
from verify.errors import InputError
from verify.io.session.session import Session
from verify.measurement.chain import Setup, measure
from verify.measurement.systematics import UNITS, stated_systematics

P_CONFIDENCE = 0.95  # two-sided, shared by the three figures: each is tested at a third of the rest
MIN_SHARE = 0.25  # of the pairs; the few that a badly moved rig leaves fit it by chance
P_DETECTION = 0.80  # with which a change of the smallest size named would be seen
REQUIRED_SOURCES = ("rig", "LED positions", "apparent LED centre", "pan angle", "square size")
HIDDEN_CHANGES = (
    "A turn or shift of both cameras together leaves every length as it is and is not seen here; "
    "it moves the robot's place in the rig: register again where that may have happened."
)


@dataclass(frozen=True, slots=True)
class DetectableChange:
    """The smallest change of one kind that this check would have seen."""

    change: str
    smallest: float | None  # in `unit`; None: however large, not by these figures
    unit: str


@dataclass(frozen=True, slots=True)
class CheckResult:
    """Whether the calibration holds, and what that rests on."""

    holds: bool
    found: RigConsistency  # scale, vertical disagreement and roll with their uncertainty
    lengths: Lengths  # each known length by itself; empty for a board
    square: tuple[float, float, float] | None  # m: known, measured, its standard uncertainty
    reprojection_rms_px: float  # distance of the spots used from where the body's pose puts them
    visible: tuple[DetectableChange, ...]
    uncounted: tuple[str, ...]  # sources that state no uncertainty: taken as exact
    decisions: tuple[str, ...]
    warnings: tuple[str, ...]

    @property
    def verdict(self) -> str:
        """`held` or `not_held`."""
        return "held" if self.holds else "not_held"


def check_session(
    session: Session,
    *,
    length: float | None = None,
    length_standard_uncertainty: float | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> CheckResult:
    """Check a rig by a session's pictures; its encoders are not used.

    Args:
        session: an opened session.
        length: m, known distance of a bar's two LEDs; None: marker.toml's own distances.
        length_standard_uncertainty: m; None: not stated.
        progress: called with pairs done and pairs in all.

    Raises:
        InputError: a bar of other than two LEDs, or no pair that shows a known length.
    """
    marker = session.marker
    pairs: Iterator[StereoPair] = session.pairs()
    setup = Setup(session.rig, marker)
    if length is not None:
        marker = bar_marker(marker, length, length_standard_uncertainty)
    if len(marker) == 2:  # nothing but its place tells the ends of a bar apart
        ends = BarTracker(session.rig, marker)
        pairs, setup = ends.watch(pairs), Setup(session.rig, marker, ends.expected)
    seen = []
    for m in measure(pairs, setup):
        seen.append(m)
        if progress is not None:
            progress(len(seen), len(session))
    return check_rig(seen, session.rig, marker)


def bar_marker(marker: Marker, length: float, standard_uncertainty: float | None = None) -> Marker:
    """Give a marker of two LEDs its known length.

    Args:
        marker: two LEDs.
        length: m, between them.
        standard_uncertainty: m, of that length; None: not stated.

    Raises:
        InputError: the marker has more LEDs or fewer.
    """
    if len(marker) != 2:
        found, expected = f"the marker has {len(marker)} LEDs", "a bar of known length has two"
        raise InputError(
            "length_mm", found, expected, "Leave it out, or use the bar's marker.toml."
        )
    middle = marker.leds.mean(axis=0)
    leds = middle + (marker.leds - middle) * length / np.linalg.norm(np.ptp(marker.leds, axis=0))
    # a length is the difference of two places: each has the root of half of its variance
    sigma = None if standard_uncertainty is None else standard_uncertainty / np.sqrt(2)
    return replace(marker, leds=leds, led_standard_uncertainty=sigma)


def check_rig(measurements: Sequence[Measurement], rig: Rig, marker: Marker) -> CheckResult:
    """Check a rig by measured LEDs.

    Args:
        measurements: what `measure` gave, all statuses.
        rig: the cameras as calibrated.
        marker: the known distances, with what is stated of them.

    Raises:
        InputError: too few pairs show two LEDs in both images where the rig would have them.
    """
    posed = [m for m in measurements if m.pose is not None]
    parameters = stated_systematics(rig, marker, _turning(posed))
    found = consistency(posed, rig, marker, parameters)
    if found is None or np.isnan(found.value[0]) or len(posed) < MIN_SHARE * len(measurements):
        raise InputError(
            "pictures",
            f"{len(posed)} of {len(measurements)} pairs show the marker where this rig would have "
            "it, and a known length",
            f"{MIN_SHARE:.0%} or more are needed",
            "Bring it into view of both cameras; if it was, the rig has moved too far to be "
            "checked: calibrate again.",
        )
    each = measured_lengths(posed, rig, marker, drop_registration(parameters))
    unseen = len(measurements) - len(posed)
    notes = [f"{unseen} of {len(measurements)} pairs could not be measured."] if unseen else []
    return _result(found, each, None, posed, parameters.uncounted, notes)


def check_board(rig: Rig, pairs: Sequence[BoardPair], board: Board) -> CheckResult:
    """Check a rig by a board; one pair is enough.

    Args:
        rig: the cameras as calibrated.
        pairs: what was seen of the board, wherever it was held.
        board: the pattern, with what is stated of its squares.

    Raises:
        InputError: no pair shows the board in both images.
    """
    both = [p for p in pairs if p.left is not None and p.right is not None]
    seen = board_poses(rig, both, board, reject=False)
    marker = board_marker(board)
    parameters = stated_systematics(rig, marker, _turning(seen))
    found = consistency(seen, rig, marker, parameters)
    if found is None or np.isnan(found.value[0]):
        expected = "both cameras must see it"
        raise InputError("pictures", "no pair shows the board in both images", expected)
    exact = [s for s in parameters.uncounted if not s.startswith(("LED", "apparent"))]
    sigma = board.square_standard_uncertainty
    if sigma is None:
        exact.append("square size")
    else:
        found = _with_scale(found, sigma / board.square)
    square = (
        board.square,
        board.square * float(1 + found.value[0]),
        board.square * float(found.uncertainty[0]),
    )
    none = np.zeros(0)
    nothing = Lengths((), none, none, none, np.zeros(0, dtype=np.int64))
    return _result(found, nothing, square, seen, exact, [])


def figure_limit(found: RigConsistency) -> float:
    """How many standard uncertainties one of the figures may be off, all of them being tested."""
    return float(norm_isf((1 - P_CONFIDENCE) / 2 / int((~np.isnan(found.value)).sum())))


def _turning(measurements: Sequence[Measurement]) -> bool:
    pans = {(m.left.pan, m.right.pan) for m in measurements if m.left and m.right}
    return len(pans) > 1


def _with_scale(found: RigConsistency, sigma: float) -> RigConsistency:
    """Add the uncertainty of the known length itself."""
    systematic = found.systematic.copy()
    systematic[0, 0] += sigma**2
    return replace(
        found,
        systematic=systematic,
        by_source={**found.by_source, "square size": np.array([sigma, 0.0, 0.0])},
    )


def _result(
    found: RigConsistency,
    each: Lengths,
    square: tuple[float, float, float] | None,
    seen: Sequence[Measurement],
    uncounted: Sequence[str],
    notes: list[str],
) -> CheckResult:
    limit = figure_limit(found)
    beyond = np.abs(np.nan_to_num(found.z)) > limit
    holds = not bool(beyond.any())
    exact = tuple(s for s in uncounted if s in REQUIRED_SOURCES)
    return CheckResult(
        holds=holds,
        found=found,
        lengths=each,
        square=square,
        reprojection_rms_px=_rms_residual(seen),
        visible=_visible(found, limit),
        uncounted=exact,
        decisions=tuple(_decisions(found, beyond, limit)),
        warnings=(*notes, *_conditions(holds, exact)),
    )


def _rms_residual(seen: Sequence[Measurement]) -> float:
    squares = [np.sum(m.pose.residual[~m.pose.rejected] ** 2, axis=1) for m in seen if m.pose]
    return float(np.sqrt(np.mean(np.concatenate(squares))))


def _visible(found: RigConsistency, limit: float) -> tuple[DetectableChange, ...]:
    """The smallest size of each change at which one of the figures would go beyond its limit."""
    needed = (limit + norm_ppf(P_DETECTION)) * found.uncertainty
    rows = []
    for change, (_, unit) in CHANGES.items():
        effect = np.abs(np.nan_to_num(found.by_change[change]))
        size = needed[effect > 0] / effect[effect > 0]
        smallest = float(np.nanmin(size)) / UNITS[unit] if len(size) else None
        rows.append(DetectableChange(change, smallest, unit))
    return tuple(rows)


def _decisions(found: RigConsistency, beyond: NDArray[np.bool_], limit: float) -> list[str]:
    said = figures_text(found)
    words = [
        f"{said[i][0].upper()}{said[i][1:]}: {'beyond' if beyond[i] else 'within'} {limit:.2f} u."
        for i in range(len(FIGURES))
        if not np.isnan(found.value[i])
    ]
    words.append(
        f"Each figure is tested two-sided, {P_CONFIDENCE:.0%} for all together, over "
        f"{len(found.frame)} pairs."
    )
    missing = [name for name, v in zip(FIGURES, found.value, strict=True) if np.isnan(v)]
    if missing:
        words.append(f"Not tested, as nothing in the pictures shows it: {', '.join(missing)}.")
    if found.left_out:
        frames = ", ".join(map(str, found.left_out))
        words.append(f"Left out, far from what all others show: pair {frames}.")
    words.append(HIDDEN_CHANGES)
    return words


def _conditions(holds: bool, exact: tuple[str, ...]) -> list[str]:
    """What the verdict rests on, and what could not be tested."""
    if not exact:
        return []
    sources = ", ".join(exact)
    words = [f"No uncertainty is stated for {sources}: taken as exact; the verdict rests on that."]
    if not holds:
        words.append(
            "Whether the rig has changed, or these never were as good as taken, could not be "
            "tested."
        )
    return words
