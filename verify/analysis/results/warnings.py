"""What a result rests on and what it leaves out, in sentences: the warnings of a report."""

from collections import Counter
from collections.abc import Iterator

import numpy as np

from verify.analysis.clock.estimate import ClockEstimate
from verify.analysis.combinations import POSE_DOF
from verify.analysis.instrument import MeasuredSession
from verify.analysis.model import JointErrorModel, SessionComparison
from verify.analysis.rig_check.check import consistency, moved_warning, unused_leds_warning
from verify.analysis.rig_check.leds import PictureMisfit, misfit_warning
from verify.analysis.uncertainty.sources import unstated_sources
from verify.analysis.verdict import CONTRADICTING
from verify.core.records import Measurement
from verify.io.session.session import Session
from verify.measurement.systematics import Systematics

MAX_LOST_SHARE = 0.1  # of the pairs: fewer may be hidden LEDs
MIN_LASTING = 0.8  # of the pairs from the first lost one on, where something has moved then
MAX_FEW = 2  # pairs that may be lost by chance, though they end the session
CONTRADICTION_ADVICE = (
    "The pictures contradict rig.toml and marker.toml there: errors and causes found in the other "
    "pairs may come from that and not from the robot. Check that both files belong to the "
    "pictures, the lenses, line_time_s and the cameras' times, and that no camera or LED has moved."
)
HIDDEN_ADVICE = (
    "Check that the LEDs are lit and in view of both cameras, as long as the arm moves, and that "
    "no camera was touched: where its rays no longer meet the other's, no LED is recognised."
)
MAX_RIVALS_NAMED = 4  # of a periodic motion's clock offsets; the list goes on for ever


def result_warnings(
    compared: SessionComparison, measured: MeasuredSession, model: JointErrorModel
) -> list[str]:
    """Every warning of a session's result, in the order of the report."""
    session, systematics, clock = compared.session, compared.systematics, compared.clock
    measurements = [m for m in measured.measurements if m.frame not in measured.repeated]
    return [
        *session.warnings,
        *_input_warnings(session, measurements, systematics, clock),
        *_contradictions(session, measurements, systematics, measured.pictures),
        *_registration_warnings(model),
        *_dof_warnings(session, model),
        *_clock_warnings(clock),
    ]


def _input_warnings(
    session: Session,
    measurements: list[Measurement],
    systematics: Systematics,
    clock: ClockEstimate,
) -> Iterator[str]:
    if exact := unstated_sources(systematics, clock):
        yield (
            f"No uncertainty is stated for {', '.join(exact)}: taken as exact; the verdict holds "
            "on that condition."
        )
    yield from filter(None, [unused_leds_warning(measurements, session.marker)])
    if systematics.unknown:
        yield (
            "rig.toml [covariance]: not counted, as the names are not known here: "
            f"{', '.join(systematics.unknown)}."
        )


def lost_pairs_warning(measurements: list[Measurement]) -> str | None:
    """Say that many pairs were not measured, why, from when on, and what that may mean."""
    lost = [i for i, m in enumerate(measurements) if m.status != "measured"]
    count = len(measurements)
    if len(lost) <= MAX_LOST_SHARE * count:
        return None
    reasons = Counter(measurements[i].status for i in lost)
    named = ", ".join(f"{number} {status}" for status, number in reasons.most_common())
    lasting = lost[0] > 0 and len(lost) > max(MIN_LASTING * (count - lost[0]), MAX_FEW)
    since = f"; nearly all lost from t_left_s = {measurements[lost[0]].t:.2f} on" * lasting
    contradicting = sum(reasons[status] for status in CONTRADICTING)
    advice = HIDDEN_ADVICE if 2 * contradicting < len(lost) else CONTRADICTION_ADVICE
    return f"Only {count - len(lost)} of {count} pairs gave a pose ({named}){since}. {advice}"


def rig_moved(
    session: Session, measurements: list[Measurement], systematics: Systematics
) -> str | None:
    """Say that the cameras no longer stand as they were calibrated, where the marker shows it."""
    found = consistency(measurements, session.rig, session.marker, systematics)
    return None if found is None else moved_warning(found, systematics.uncounted)


def _contradictions(
    session: Session,
    measurements: list[Measurement],
    systematics: Systematics,
    pictures: PictureMisfit | None,
) -> Iterator[str]:
    """What the pictures themselves say against rig.toml and marker.toml."""
    if session.instrument is not None:
        return
    lost = lost_pairs_warning(measurements)
    moved = rig_moved(session, measurements, systematics)
    told = moved is not None or CONTRADICTION_ADVICE in (lost or "")
    misfit = None if pictures is None else misfit_warning(pictures, told=told)
    yield from filter(None, [lost, lost and _standing_pans(session), moved, misfit])


def _standing_pans(session: Session) -> str:
    """Name pan readings that never change, of a base that seems to turn."""
    frames, cameras = session.frames, (session.rig.left, session.rig.right)
    pans = {"pan_left_deg": frames.pan_left, "pan_right_deg": frames.pan_right}
    standing = " and of ".join(name for name, pan in pans.items() if not np.ptp(pan))
    turning = " and " not in standing or any(c.pan_standard_uncertainty for c in cameras)
    text = f"frames.csv: no two readings of {standing} differ. If that base turns, pairs are lost "
    return f"{text}by it: check how it is recorded." if standing and turning else ""


def _registration_warnings(model: JointErrorModel) -> Iterator[str]:
    if model.through_encoders:
        yield (
            "Base or LED positions were fitted through the robot's own encoders: the errors in "
            "frames.csv are residuals, which may point to the wrong joint; mean errors come from a "
            "fit together with that registration."
        )
    if model.stands_in:
        yield "The motion of that registration is not known: this session's stands for it."


def _dof_warnings(session: Session, model: JointErrorModel) -> Iterator[str]:
    joints, determined = session.arm.dof, model.comparison.determined
    known = min(b.shape[1] for b in determined)
    if joints > POSE_DOF:
        yield (
            f"A pose determines six combinations of the robot's {joints} joints: along its "
            "self-motion no pair tells them apart, so single joints stay empty in frames.csv; "
            "mean errors come from a fit over the session."
        )
    if known < POSE_DOF:
        of = f"{sum(b.shape[1] < POSE_DOF for b in determined)} of {len(determined)}"
        who = f"{of} poses" if session.instrument else f"The LEDs of {of} pairs"
        yield (
            f"{who} determine only {known} of 6 degrees of freedom: joints that the open ones "
            "move stay empty there; mean errors of joints that no pair determines come from a fit "
            "over the session."
        )


def _clock_warnings(clock: ClockEstimate) -> Iterator[str]:
    if clock.rivals:
        others = ", ".join(f"{o:+.3f}" for o in clock.rivals[:MAX_RIVALS_NAMED])
        yield (
            f"The motion fits at {len(clock.rivals)} other offsets of the readings' clock as well: "
            f"{others} s. The verdict does not depend on the choice; state [clock] "
            "encoder_offset_s, record t_host_s, or add a movement that does not repeat."
        )
    if clock.source == "none":
        yield (
            "The motion (at rest, at constant speed, or not the one that the readings tell) does "
            f"not show the clock offset: readings are taken {clock.offset:g} s later than stamped."
        )
