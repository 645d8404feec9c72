"""Turn recorded sessions of one arm into the rows of an identification."""

import os
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd

from robots.transforms import rigid_columns
from verify.analysis.comparison import Comparison, ReadingUncertainty, compare
from verify.analysis.instrument import stated_noise
from verify.analysis.least_squares import autocorrelation
from verify.analysis.model import add_pan_noise, clock_effect, prior_columns
from verify.analysis.session import measure_session
from verify.calibration.kinematics.chain import ArmState, KinematicChain
from verify.calibration.kinematics.fit import KinematicFit, pose_residuals
from verify.calibration.kinematics.poses import IdentificationPoses, build_poses
from verify.core.readings import Readings
from verify.core.records import Array, Index, Progress, take_rows
from verify.errors import InputError
from verify.io.series import FrameSeries
from verify.io.session.session import Session
from verify.measurement.chain import measure

N_BLOCKS = 10  # of a session, one after the other: neighbouring pairs repeat each other's posture
CLOCK_PRIOR_SIGMA = 1.0  # s, prior of an offset that is found with everything else


@dataclass(frozen=True, slots=True)
class SessionPoses:
    """Compared poses of one session, and their systematic effects."""

    session: Session
    comparison: Comparison
    frame: Index  # (n,), number of each pair or pose
    stated: Array  # (n, 6, p), unit variance: what rig and marker state of themselves
    own: Array  # (n, 6, r), unit variance: clock, alignment, pan readings
    uncounted: tuple[str, ...]

    @property
    def noise_stated(self) -> bool:
        """The poses' noise is known: of pictures always, of another instrument where it says so."""
        instrument = self.session.instrument
        return instrument is None or stated_noise(instrument).known

    @property
    def point(self) -> Array | None:
        """The measured point in the flange frame, (3,), m; None where poses were measured."""
        instrument = self.session.instrument
        if instrument is None or not instrument.positions_alone:
            return None
        return instrument.flange_T_body[:3, 3]


@dataclass(frozen=True, slots=True)
class CombinedPoses:
    """Several sessions as one set of rows, in their order."""

    poses: IdentificationPoses
    sessions: tuple[SessionPoses, ...]
    source: Index  # (n,), which session
    frame: Index  # (n,), number of the pair or pose in its session
    tools: Array  # (h, 4, 4), flange_T_target as the sessions have them
    free_base: bool  # the base was found through these encoders: its place proves nothing
    free_tool: bool

    def state(self, chain: KinematicChain) -> ArmState:
        """Bases and tools as the sessions have them: the poses are in the base's frame."""
        placings = int(self.poses.base.max()) + 1
        return ArmState(chain, np.tile(np.eye(4), (placings, 1, 1)), self.tools)


def require_one_arm(sessions: Sequence[Session]) -> None:
    """Refuse sessions of different arms, and one that is given twice, be it as a copy.

    Raises:
        InputError: names the session at fault.
    """
    first = sessions[0]
    for i, session in enumerate(sessions[1:], start=1):
        for other in sessions[:i]:
            if _recorded(session) == _recorded(other):
                same = session.folder.resolve() == other.folder.resolve()
                found = "is given twice" if same else f"holds the same recording as {other.folder}"
                remedy = "Give it once."
                raise InputError(session.folder, found, "its poses would count twice", remedy)
        if session.arm.fingerprint != first.arm.fingerprint:
            raise InputError(
                session.folder,
                f"is of {session.robot}",
                f"{first.folder} is of {first.robot}, and one arm is identified at a time",
                "Give the sessions of one arm.",
            )


def _recorded(session: Session) -> set[str]:
    """Digests of what was recorded, without the TOML files that say how it is to be read."""
    return {digest for name, digest in session.inputs.items() if not name.endswith(".toml")}


def split_targets(session: Session) -> list[Session]:
    """The sessions of each target by itself, of an instrument that measured several."""
    instrument = session.instrument
    if instrument is None or (target := instrument.poses.target) is None:
        return [session]
    parts = []
    for number in np.unique(target):
        own = take_rows(instrument.poses, target == number)
        parts.append(replace(
            session,
            name=f"{session.name} (target {number:.0f})",
            frames=FrameSeries(own.t, own.t, 0 * own.t, 0 * own.t),
            instrument=replace(instrument, poses=replace(own, target=None, of_several=True)),
        ))  # fmt: skip
    return parts


def session_to_poses(
    session: Session, progress: Progress, *, registered: bool = True
) -> SessionPoses:
    """Measure a session and compare its poses with the readings; `measure_session` says how.

    Raises:
        InputError: no pair could be measured, or none has a reading.
    """
    readings = Readings.of_log(session.encoders.t, session.encoders.q)
    session, measured, clock = measure_session(
        session, readings, progress, measure, registered=registered
    )
    track, systematics = measured.track, measured.systematics
    compared = compare(
        track, session.arm, readings, clock.offset,
        stated=ReadingUncertainty(
            session.encoder_resolution, session.encoder_time_standard_uncertainty
        ),
    )  # fmt: skip
    if not len(compared):
        raise InputError(
            session.folder / "encoders.csv",
            f"no reading for any of the {len(track)} measured pairs",
            "readings must cover the pictures once [clock] encoder_offset_s is added",
            "Check that clock and recording belong together.",
        )
    compared = add_pan_noise(compared, track, systematics)
    held = prior_columns(compared, track, clock, systematics)
    count = len(systematics.names)
    own = held[:, :, count:]
    if clock.source != "given":
        drift = clock_effect(compared, steady=clock.source == "none")
        own = np.concatenate([own, drift * CLOCK_PRIOR_SIGMA], axis=2)
    frame = track.frame[compared.index].astype(np.int64)
    return SessionPoses(session, compared, frame, held[:, :, :count], own, systematics.uncounted)


def gather_sessions(sessions: Sequence[SessionPoses]) -> CombinedPoses:
    """Lay sessions out as rows.

    A base is shared by sessions whose rig has it at the same place, LEDs by those whose marker has
    them there; what rig and marker state of themselves is shared with them.

    Raises:
        InputError: some hold poses, others positions alone.
    """
    sizes = [len(one.comparison) for one in sessions]
    bases = _groups(one.session.rig.rig_T_base.tobytes() for one in sessions)
    tools = _groups(_mounting(one) for one in sessions)
    source = np.repeat(np.arange(len(sessions)), sizes)
    # the targets of one session are one recording, and its parts are held out together
    recording = _groups(os.fsencode(one.session.folder) for one in sessions)
    parts = [
        np.arange(n) * min(N_BLOCKS, n) // n + N_BLOCKS * i
        for i, n in zip(recording.tolist(), sizes, strict=True)
    ]
    block = np.concatenate(parts)
    nuisance = _nuisances(sessions, bases, tools)
    points = [one.point for one in sessions if one.point is not None]
    # what is not stated is estimated from the fit's residuals, not from how neighbours scatter
    stated = all(one.noise_stated for one in sessions)
    mounted = np.tile(np.eye(4), (int(tools.max()) + 1, 1, 1))
    if points and len(points) < len(sessions):
        alone = next(one.session.folder for one in sessions if one.point is not None)
        raise InputError(
            alone, "holds positions alone, another session poses",
            "one kind is identified from at a time", "Identify from each by itself.",
        )  # fmt: skip
    if points:
        mounted[tools, :3, 3] = points
        rows = _point_rows(sessions, points, nuisance, stated=stated)
    else:
        rows = build_poses(
            np.concatenate([one.comparison.q for one in sessions]),
            np.concatenate([one.comparison.base_T_measured for one in sessions]),
            np.concatenate([one.comparison.covariance for one in sessions]) if stated else None,
            nuisance=nuisance,
            determined=tuple(known for one in sessions for known in one.comparison.determined),
        )
    return CombinedPoses(
        poses=replace(
            rows, base=bases[source], tool=tools[source], recording=recording[source], block=block
        ),
        sessions=tuple(sessions),
        source=source,
        frame=np.concatenate([one.frame for one in sessions]),
        tools=mounted,
        free_base=any(one.session.rig.base_source == "motion" for one in sessions),
        free_tool=any(tool_open(one.session) for one in sessions),
    )


def _point_rows(
    sessions: Sequence[SessionPoses], points: Sequence[Array], nuisance: Array, *, stated: bool
) -> IdentificationPoses:
    """Gather positions of a point; the poses that stand for them have an arbitrary rotation."""
    measured, gains = [], []
    for one, point in zip(sessions, points, strict=True):
        pose = one.comparison.base_T_measured
        lever = pose[:, :3, :3] @ point
        measured.append(pose[:, :3, 3] + lever)
        gains.append(rigid_columns(lever))
    gain = np.concatenate(gains)
    covariance = np.concatenate([one.comparison.covariance for one in sessions])
    moved = np.zeros_like(nuisance)
    moved[:, :3] = gain @ nuisance
    return build_poses(
        np.concatenate([one.comparison.q for one in sessions]),
        np.concatenate(measured),
        gain @ covariance @ np.swapaxes(gain, 1, 2) if stated else None,
        nuisance=moved,
    )


def tool_open(session: Session) -> bool:
    """The target's place was found through the encoders, or nobody says where it is."""
    instrument = session.instrument
    return session.marker.source == "motion" or (instrument is not None and not instrument.placed)


def _mounting(one: SessionPoses) -> bytes:
    """Identify a mounting on the flange; a target that nobody placed is its session's own."""
    instrument = one.session.instrument
    if instrument is None:
        return one.session.marker.leds.tobytes()
    return instrument.flange_T_body.tobytes() if instrument.placed else one.session.name.encode()


def deflate_repetition(gathered: CombinedPoses, fit: KinematicFit) -> CombinedPoses:
    """Reduce the weight of rows that repeat each other's errors, by a first fit's residuals.

    Neighbours in time do, and visits to one posture, by what the model does not describe.
    """
    rows = gathered.poses
    white = fit.scale.whiten(rows, pose_residuals(fit.state, rows))
    white[np.all(rows.whitener == 0, axis=2) | ~fit.used[:, None]] = np.nan
    factors = _posture_correlation(white, rows.posture)
    for i in range(len(gathered.sessions)):
        own = gathered.source == i
        factors[own] = np.maximum(factors[own], autocorrelation(white[own]))
    whitener = rows.whitener / np.sqrt(factors)[:, :, None]
    return replace(gathered, poses=replace(rows, whitener=whitener, votes=rows.votes / factors))


def _posture_correlation(white: Array, posture: Index) -> Array:
    """By how much whitened residuals (n, 6) alike in one posture inflate a mean's variance, >= 1.

    1 + (m - 1) rho in a posture (n,) of m rows, with rho the intraclass correlation.
    """
    alike = pd.DataFrame(white).groupby(posture)
    total, count = (alike.transform(kind).to_numpy() for kind in ("sum", "count"))
    others = np.maximum(count - 1, 0)
    pairs = np.maximum(np.where(np.isnan(white), 0, others).sum(axis=0), 1)
    power = np.nansum(white**2, axis=0) / np.maximum(np.isfinite(white).sum(axis=0), 1)
    rho = np.nansum(white * (total - white), axis=0) / pairs / np.where(power > 0, power, 1.0)
    return np.asarray(1 + others * np.clip(rho, 0.0, 1.0))


def _groups(keys: Iterable[bytes]) -> Index:
    known: dict[bytes, int] = {}
    return np.array([known.setdefault(key, len(known)) for key in keys], dtype=np.int64)


def _nuisances(sessions: Sequence[SessionPoses], bases: Index, tools: Index) -> Array:
    """Place every session's columns: shared ones above each other, its own to the right."""
    shared: dict[tuple[int, int, int], int] = {}
    places, width = [], 0
    for one, base, tool in zip(sessions, bases.tolist(), tools.tolist(), strict=True):
        key = (base, tool, one.stated.shape[2])
        if key not in shared:
            shared[key] = width
            width += one.stated.shape[2]
        places.append((shared[key], width))
        width += one.own.shape[2]
    blocks = []
    for one, (first, second) in zip(sessions, places, strict=True):
        block = np.zeros((len(one.comparison), 6, width))
        block[:, :, first : first + one.stated.shape[2]] = one.stated
        block[:, :, second : second + one.own.shape[2]] = one.own
        blocks.append(block)
    return np.concatenate(blocks)
