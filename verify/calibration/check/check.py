"""Check whether a calibration still holds, by known lengths anywhere in the volume.

Every session, or a board, gives three figures with covariance U (stated sources and scatter):

    0   scale                    relative error of known lengths        1
    1   vertical disagreement    of the two images of one point         px
    2   roll                     of the images against each other       rad

The calibration holds where |figure_k| <= z u_k for all of them, u_k² = U_kk, z such that noise
exceeds it in one check in twenty. A change of which the figures move by g_k a unit would have been
found with 80 % probability from the size (z + 0.84) u_k / |g_k| on, the least over k.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from verify.analysis.rig_check import check as rig_check
from verify.analysis.rig_check.leds import LED_ADVICE, displacement_text, picture_misfit
from verify.calibration.board.pose import board_marker, board_poses
from verify.calibration.check.lengths import BarTracker, Lengths, measured_lengths
from verify.calibration.stereo.records import rms
from verify.core.fiducials import Board, BoardPair, Marker
from verify.core.records import Flags, Measurement, Progress, StereoPair, no_progress
from verify.core.rig import Rig
from verify.core.statistics import norm_isf, norm_ppf
from verify.errors import InputError
from verify.io.session.session import Session
from verify.measurement.chain import Setup, measure
from verify.measurement.systematics import UNITS, stated_systematics

P_CONFIDENCE = 0.95  # two-sided, of all figures together
MIN_SHARE = 0.25  # of the pairs; the few that a badly moved rig leaves fit it by chance
P_DETECTION = 0.80  # of the smallest change that is named
REQUIRED_SOURCES = ("rig", "LED positions", "apparent LED centre", "pan angle", "square size")
HIDDEN_CHANGES = (
    "A turn or shift of both cameras together leaves every length as it is and is not seen here; "
    "it moves the robot's place in the rig: register again where that may have happened."
)


@dataclass(frozen=True, slots=True)
class CheckResult:
    """Whether the calibration holds, and what that rests on."""

    holds: bool
    found: rig_check.RigConsistency  # scale, vertical disagreement and roll with their uncertainty
    lengths: Lengths  # each known length by itself; empty for a board
    square: tuple[float, float, float] | None  # m: known, measured, its standard uncertainty
    reprojection_rms_px: float  # of the spots used against the body's pose
    # the smallest change of each kind that this check would have found, in its unit; None: these
    # figures do not respond to it
    visible: dict[str, tuple[float | None, str]]
    uncounted: tuple[str, ...]  # sources that state no uncertainty: taken as exact
    decisions: tuple[str, ...]
    warnings: tuple[str, ...]
    displaced: str | None = None  # the LED that is not where marker.toml puts it, in words

    @property
    def verdict(self) -> str:
        """`held` or `not_held`."""
        return "held" if self.holds else "not_held"


def check_session(
    session: Session,
    *,
    length: float | None = None,
    length_standard_uncertainty: float | None = None,
    progress: Progress = no_progress,
) -> CheckResult:
    """Check a rig by a session's pictures; its encoders are not used.

    The length of a bar's two LEDs and its uncertainty are in m; None: marker.toml's own distances,
    and not stated. `progress` is called with pairs done and pairs in all.

    Raises:
        InputError: a bar of other than two LEDs, no pair that shows a known length, or a single one
            whose pictures were not taken together.
    """
    marker = session.marker
    late = session.frames.t_right - session.frames.t_left
    if len(session) == 1 and late.any():
        raise InputError(
            session.folder,
            f"has one pair, its right picture {1e3 * late[0]:+.1f} ms after the left one",
            "how the LEDs moved meanwhile shows in the pairs beside it",
            "Record more pairs.",
        )
    pairs: Iterator[StereoPair] = session.pairs()
    setup = Setup(session.rig, marker)
    if length is not None:
        marker = bar_marker(marker, length, length_standard_uncertainty)
    if len(marker) == 2:  # nothing but its place tells the ends of a bar apart
        ends = BarTracker(session.rig, marker)
        pairs, setup = ends.watch(pairs), Setup(session.rig, marker, ends.expected)
    measurements = []
    for measurement in measure(pairs, setup):
        measurements.append(measurement)
        progress(len(measurements), len(session))
    return check_rig(measurements, session.rig, marker)


def bar_marker(marker: Marker, length: float, standard_uncertainty: float | None = None) -> Marker:
    """Give a marker of two LEDs its known length, m, with its standard uncertainty, m, if stated.

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
    """Check a rig by what `measure` gave, all statuses, and the marker's known distances.

    Raises:
        InputError: too few pairs show two LEDs in both images where the rig would have them.
    """
    posed = [m for m in measurements if m.pose is not None]
    parameters = stated_systematics(rig, marker, _turning(posed))
    found = rig_check.consistency(posed, rig, marker, parameters)
    if found is None or np.isnan(found.value[0]) or len(posed) < MIN_SHARE * len(measurements):
        raise InputError(
            "pictures",
            f"{len(posed)} of {len(measurements)} pairs show the marker where this rig would have "
            "it, and a known length",
            f"{MIN_SHARE:.0%} or more are needed",
            "Bring it into view of both cameras; if it was, the rig has moved too far to be "
            "checked: calibrate again.",
        )
    each = measured_lengths(posed, rig, marker, rig_check.drop_registration(parameters))
    result = _result(found, each, None, posed, parameters.uncounted)
    lost = len(measurements) - len(posed)
    notes = [f"{lost} of {len(measurements)} pairs could not be measured."] * (lost > 0)
    unseen = rig_check.unused_leds_warning(posed, marker) if result.holds else None
    result = replace(result, warnings=(*filter(None, [unseen]), *notes, *result.warnings))
    pictures = picture_misfit(measurements, rig, marker, parameters)
    if pictures is None or pictures.led is None:
        return result
    led = f"{displacement_text(pictures.led)}: {LED_ADVICE}"
    return replace(result, holds=False, displaced=led, decisions=(led, *result.decisions))


def check_board(rig: Rig, pairs: Sequence[BoardPair], board: Board) -> CheckResult:
    """Check a rig by a board, wherever it was held; one pair is enough.

    Raises:
        InputError: no pair shows the board in both images.
    """
    both = [p for p in pairs if p.left is not None and p.right is not None]
    poses = board_poses(rig, both, board)
    marker = board_marker(board)
    parameters = stated_systematics(rig, marker, _turning(poses))
    found = rig_check.consistency(poses, rig, marker, parameters)
    if found is None or np.isnan(found.value[0]):
        expected = "both cameras must see it"
        raise InputError("pictures", "no pair shows the board in both images", expected)
    exact = [s for s in parameters.uncounted if not s.startswith(("LED", "apparent"))]
    sigma = board.square_standard_uncertainty
    if sigma is None:
        exact.append("square size")
    else:  # the known length's own uncertainty
        share = sigma / board.square
        systematic = found.systematic.copy()
        systematic[0, 0] += share**2
        by_source = {**found.by_source, "square size": np.array([share, 0.0, 0.0])}
        found = replace(found, systematic=systematic, by_source=by_source)
    scale, u = float(1 + found.value[0]), float(found.uncertainty[0])
    square = (board.square, board.square * scale, board.square * u)
    return _result(found, measured_lengths([], rig, marker, parameters), square, poses, exact)


def figure_limit(found: rig_check.RigConsistency) -> float:
    """Limit of each figure, in standard uncertainties, when all of them are tested."""
    return float(norm_isf((1 - P_CONFIDENCE) / 2 / int((~np.isnan(found.value)).sum())))


def _turning(measurements: Sequence[Measurement]) -> bool:
    return len({(m.left.pan, m.right.pan) for m in measurements if m.left and m.right}) > 1


def _result(
    found: rig_check.RigConsistency,
    each: Lengths,
    square: tuple[float, float, float] | None,
    poses: Sequence[Measurement],
    uncounted: Sequence[str],
) -> CheckResult:
    limit = figure_limit(found)
    beyond = np.abs(np.nan_to_num(found.z)) > limit
    residuals = [m.pose.residual[~m.pose.rejected] for m in poses if m.pose]
    holds = not bool(beyond.any())
    exact = tuple(s for s in uncounted if s in REQUIRED_SOURCES)
    return CheckResult(
        holds=holds,
        found=found,
        lengths=each,
        square=square,
        reprojection_rms_px=rms(np.concatenate(residuals)),
        visible=_visible(found, limit),
        uncounted=exact,
        decisions=tuple(_decisions(found, beyond, limit)),
        warnings=tuple(_conditions(holds, exact)),
    )


def _visible(found: rig_check.RigConsistency, limit: float) -> dict[str, tuple[float | None, str]]:
    """Find the smallest size of each change at which a figure would exceed its limit."""
    needed = (limit + norm_ppf(P_DETECTION)) * found.uncertainty
    visible = {}
    for change, (_, unit) in rig_check.CHANGES.items():
        effect = np.abs(np.nan_to_num(found.by_change[change]))
        size = needed[effect > 0] / effect[effect > 0]
        smallest = float(np.nanmin(size)) / UNITS[unit] if len(size) else None
        visible[change] = smallest, unit
    return visible


def _decisions(found: rig_check.RigConsistency, beyond: Flags, limit: float) -> Iterator[str]:
    for text, exceeded, value in zip(
        rig_check.figures_text(found), beyond, found.value, strict=True
    ):
        if not np.isnan(value):
            verdict = "beyond" if exceeded else "within"
            yield f"{text[0].upper()}{text[1:]}: {verdict} {limit / 2:.2f} U (k = 2)."
    yield (
        f"Each figure is tested two-sided, {P_CONFIDENCE:.0%} for all together, over "
        f"{len(found.frame)} pairs."
    )
    missing = [name for name, v in zip(rig_check.FIGURES, found.value, strict=True) if np.isnan(v)]
    if missing:
        yield f"Not tested, as nothing in the pictures shows it: {', '.join(missing)}."
    if found.left_out:
        frames = ", ".join(map(str, found.left_out))
        yield f"Left out, far from what all others show: pair {frames}."
    yield HIDDEN_CHANGES


def _conditions(holds: bool, exact: tuple[str, ...]) -> Iterator[str]:
    """State what the verdict rests on, and what could not be tested."""
    if not exact:
        return
    sources = ", ".join(exact)
    yield f"No uncertainty is stated for {sources}: taken as exact; the verdict rests on that."
    if not holds:
        yield (
            "Whether the rig has changed, or its calibration never was as good as "
            "stated, could not be tested."
        )
