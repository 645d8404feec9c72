"""Turn poses that another instrument measured into measurements with covariance.

A pose from a file has no spots: its covariance comes from the file, from session.toml, or from the
poses' own scatter, and the systematic parameters are those of the robot's base and of the body on
the flange.
"""

from collections.abc import Iterator, Set
from dataclasses import dataclass, replace

import numpy as np

import robots
from robots.transforms import difference, rigid_columns
from verify.analysis.comparison import (
    Comparison,
    ReadingUncertainty,
    body_motion,
    compare,
    placement_columns,
    twist_transport,
)
from verify.analysis.rig_check.leds import DisplacedLed, LedShifts, PictureMisfit
from verify.core.fiducials import Marker
from verify.core.readings import Readings
from verify.core.records import POSE_NAMES, Array, Index, Measurement, Pose, rigid_transform
from verify.core.rig import Rig
from verify.io.session.poses import Instrument
from verify.io.session.session import Session
from verify.measurement.alignment import MAX_GAP
from verify.measurement.systematics import Systematics, by_base, stated_systematics
from verify.measurement.track import Track, collect_track

NOISE = "the instrument's noise"
CALIBRATION_SOURCE = "the instrument's own calibration"
BODY_SOURCE = "the body on the flange"
WINDOW = 5  # poses in a row that a parabola is laid through: two are left over
MIN_WINDOWS = 12  # for a scatter that is worth the name; else a fit tells
MAX_GAIN = 100.0  # of the variance left without it: by chance once in a million poses
MIN_KEPT = 0.9  # of the poses: more are no single mistakes
MEDIAN_CHI2 = 5.348  # of six degrees of freedom: two that are left over, of three coordinates
# a variance from a median of squares is less certain than one from their mean
MEDIAN_VARIANCE_FACTOR = 1.3
LAST_DIGIT = 2 * np.sqrt(12)  # standard uncertainties of its rounding: twice a last digit
PARTS = (slice(0, 3), slice(3, 6))  # translation and rotation of a twist


@dataclass(frozen=True, slots=True)
class InstrumentNoise:
    """What varies from pose to pose: standard uncertainties a coordinate, in the file's axes."""

    position: Array  # (n, 3), m
    orientation: Array  # (n, 3), rad
    position_known: bool  # stated, or found in the data
    orientation_known: bool  # also where no orientation was measured

    @property
    def known(self) -> bool:
        """Nothing is left to be found, or to be taken as exact."""
        return self.position_known and self.orientation_known


@dataclass(frozen=True, slots=True)
class MeasuredSession:
    """What the pictures, or the instrument, gave."""

    measurements: list[Measurement]
    track: Track
    systematics: Systematics
    preview: bytes | None = None  # PNG of a pair; an instrument's poses have none
    alike: tuple[int, ...] = ()  # frames of which a picture is that of an earlier pair
    repeated: frozenset[int] = frozenset()  # of these, those left out, as the readings move
    pictures: PictureMisfit | None = None  # how they agree with rig.toml and marker.toml
    displaced: DisplacedLed | None = None  # not in its place, and left out of all of these
    shifts: LedShifts | None = None  # of all LEDs from marker.toml's places: not used for these


def stated_noise(instrument: Instrument) -> InstrumentNoise:
    """What the file or [poses] states; where neither does, what the last decimal leaves."""
    poses = instrument.poses
    given = poses.position_uncertainty, poses.orientation_uncertainty
    constant = instrument.position_uncertainty, instrument.orientation_uncertainty
    position, orientation = (
        own if own is not None else np.full((len(poses), 3), least if rest is None else rest)
        for own, rest, least in zip(given, constant, poses.rounding, strict=True)
    )
    known = [own is not None or rest is not None for own, rest in zip(given, constant, strict=True)]
    return InstrumentNoise(position, orientation, known[0], known[1] or instrument.positions_alone)


def measure_poses(
    session: Session,
    instrument: Instrument,
    readings: Readings,
    noise: InstrumentNoise,
    offset: float | None = None,
    repeated: Set[int] = frozenset(),
) -> MeasuredSession:
    """Take an instrument's poses as measured; each carries this noise.

    The poses are the session's, or others. `offset`, s, is that of the readings' clock as far as it
    is known; None: as session.toml has it. `repeated` rows are left out. Where positions alone were
    measured the orientation follows the readings, a gauge that no statistic sees; the nearer, the
    sooner it settles.
    """
    if offset is None:
        offset = 0.0 if session.clock is None else session.clock.encoder_offset
    measurements = [
        replace(m, status="unaligned", pose=None) if m.frame in repeated else m
        for m in _measurements(session, instrument, readings, noise, offset)
    ]
    systematics = _stated_uncertainties(session, noise)
    moved = [
        instrument_sensitivities(systematics, m, session.rig, session.marker)
        for m in measurements
        if m.pose is not None
    ]
    track = collect_track(measurements, session.rig, moved)
    return MeasuredSession(measurements, track, systematics, repeated=frozenset(repeated))


def repeated_poses(
    session: Session, instrument: Instrument, readings: Readings, offset: float
) -> set[int]:
    """Rows that repeat an earlier one to the last digit, though the measured body has moved.

    The readings show that, by more than the last digit; `offset`, s, is added to their time.
    """
    poses, t = instrument.poses, instrument.poses.t - offset
    numbers = poses.transforms.reshape(len(poses), 16)
    _, first, group = np.unique(numbers, axis=0, return_index=True, return_inverse=True)
    since = first[group]
    q, known = readings.at(t), readings.available(t)
    read = robots.forward(session.arm, q) @ instrument.flange_T_body
    digit = LAST_DIGIT * np.repeat(poses.rounding, 3)
    changed = np.abs(difference(read, read[since])) > digit
    changed[:, 3:] &= not instrument.positions_alone
    turned = np.abs(q - q[since]) > readings.resolved
    moved = np.flatnonzero(changed.any(axis=1) & turned.any(axis=1) & known & known[since])
    # back where it had measured that pose, it still repeats it
    begin = np.full(len(first), len(poses))
    np.minimum.at(begin, group[moved], moved)
    return set(np.flatnonzero(np.arange(len(poses)) >= begin[group]).tolist())


def _measurements(
    session: Session,
    instrument: Instrument,
    readings: Readings,
    noise: InstrumentNoise,
    offset: float,
) -> Iterator[Measurement]:
    """One measured pair a pose."""
    poses, flange_T_body = instrument.poses, instrument.flange_T_body
    if poses.rotation is not None:
        rig_R_flange = poses.rotation @ flange_T_body[:3, :3].T
    else:
        there = np.clip(poses.t - offset, *readings.t[[0, -1]])
        base_T_flange = robots.forward(session.arm, readings.at(there))
        rig_R_flange = session.rig.rig_T_base[:3, :3] @ base_T_flange[:, :3, :3]
    lever = rig_R_flange @ flange_T_body[:3, 3]
    for i, t in enumerate(poses.t.tolist()):
        rig_T_flange = rigid_transform(rig_R_flange[i], poses.position[i] - lever[i])
        gain, determined = _point_to_flange(lever[i], alone=instrument.positions_alone)
        sigma = np.concatenate([noise.position[i], noise.orientation[i]])[: gain.shape[1]]
        pose = Pose(  # without spots; how it moves, no picture says
            rig_T_flange=rig_T_flange,
            covariance_pixels=(gain * sigma**2) @ gain.T,
            covariance_alignment=np.zeros((6, 6)),  # one instrument, one instant
            twist=np.full(6, np.nan),
            acceleration_prior=(np.nan, np.nan),
            determined=determined,
            gain=np.zeros((6, 0)),
            sensitivity=np.zeros((0, 2, 3)),
            curvature=np.zeros((0, 2)),
            residual=np.zeros((0, 2)),
            spot_uncertainty=np.zeros(0),
            rejected=np.zeros(0, dtype=np.bool_),
            consistent=True,
            chi2=0.0,
            degrees_of_freedom=0,
        )
        yield Measurement(frame=i, t=t, status="measured", leds_seen=0, pose=pose)


def _point_to_flange(lever: Array, *, alone: bool) -> tuple[Array, Array]:
    """How the flange moves with what was measured, and what of it is determined.

    `lever` (3,), m, from the flange to the measured point, in the instrument's axes; `alone`: the
    position alone was measured, else the pose. Gives (6, 3 or 6), the flange's twist by the point's
    shift (and the body's turn); and (6, d), orthonormal.
    """
    if not alone:
        return twist_transport(-lever), np.eye(6)
    point = rigid_columns(lever)  # of a twist: rho + phi x lever
    determined = np.linalg.qr(point.T)[0]
    return determined @ np.linalg.inv(point @ determined), determined


def _stated_uncertainties(session: Session, noise: InstrumentNoise) -> Systematics:
    """What is stated of the robot's base and of the body; the rest is taken as exact."""
    found = stated_systematics(session.rig, session.marker, turning=False)
    mine = [i for i, n in enumerate(found.names) if n.startswith(("robot_base.", "body."))]
    names = tuple(found.names[i] for i in mine)
    heads = {name.partition(".")[0] for name in names}
    counted = {
        "robot base": "robot_base" in heads,
        BODY_SOURCE: "body" in heads,
        NOISE: noise.known,
        CALIBRATION_SOURCE: False,
        "robot table": False,
    }
    return replace(
        found,
        names=names,
        sources=tuple(BODY_SOURCE if n.startswith("body.") else "robot base" for n in names),
        covariance=found.covariance[np.ix_(mine, mine)],
        pan=np.full(2, np.nan),
        uncounted=tuple(source for source, counts in counted.items() if not counts),
    )


def instrument_sensitivities(
    parameters: Systematics, measurement: Measurement, rig: Rig, _marker: Marker
) -> Array:
    """How the measured pose in the robot's base changes with each parameter; (6, p + 2).

    As `systematics.sensitivities`; its last two columns are pan readings, which there are none of.
    """
    if measurement.pose is None:
        raise ValueError("only a measured pose has sensitivities")
    by_body = -body_motion(np.linalg.inv(rig.rig_T_base) @ measurement.pose.rig_T_flange[None])[0]
    by = {"body": by_body, "robot_base": by_base(rig, measurement.pose)}
    columns = np.zeros((6, len(parameters.names) + 2))
    for i, name in enumerate(parameters.names):
        head, _, key = name.partition(".")
        columns[:, i] = by[head][:, POSE_NAMES.index(key)]
    return columns


def noise_from_scatter(
    session: Session, instrument: Instrument, track: Track, readings: Readings, offset: float
) -> InstrumentNoise | None:
    """Noise that is not (or not all) stated, from the data's own scatter about the readings.

    How far the poses lie from where the readings put them changes slowly, whatever is wrong with
    the robot; a parabola through five in a row leaves the noise. The median over all windows keeps
    single jumps out; the readings' own share is taken off. Of single visits the noise is what a
    linear model of base, target and joints leaves (`_full_model_variances`). `offset`, s, is that
    of the readings' clock; None where poses are too few to show the noise.
    """
    comparison = compare(
        track, session.arm, readings, offset, stated=ReadingUncertainty(session.encoder_resolution)
    )
    # at the measured point: of positions alone, nothing else is known
    point = instrument.flange_T_body[:, 3]
    off = comparison.xi.copy()
    off[:, :3] = ((comparison.base_T_encoder - comparison.base_T_measured) @ point)[:, :3]
    of_readings = comparison.covariance - comparison.covariance_measured
    first = _windows(comparison.t)
    if len(first) >= MIN_WINDOWS:
        squares = _residual_squares(comparison.t, off, first)
        total = [float(np.median(squares[:, part].sum(axis=1))) / MEDIAN_CHI2 for part in PARTS]
        doubt = MEDIAN_VARIANCE_FACTOR * np.sqrt(2 / (2 * 3 * len(comparison) / WINDOW))
    elif (found := _full_model_variances(comparison, off, point)) is not None:
        total, doubt = found
    else:
        return None
    sigma = []
    for part, variance, least in zip(PARTS, total, instrument.poses.rounding, strict=True):
        share = np.trace(of_readings[:, part, part], axis1=1, axis2=2).mean() / 3
        # noise that drowns in the readings' own may be as large as the doubt of the difference
        sigma.append(float(np.sqrt(max(variance - share, doubt * variance, least**2))))
    noise = stated_noise(instrument)
    return InstrumentNoise(
        noise.position if noise.position_known else np.full_like(noise.position, sigma[0]),
        noise.orientation if noise.orientation_known else np.full_like(noise.orientation, sigma[1]),
        position_known=True,
        orientation_known=True,
    )


def _full_model_variances(
    comparison: Comparison, off: Array, point: Array
) -> tuple[list[float], float] | None:
    """What a model of all causes leaves of places and turns (n, 6), and its relative doubt.

    Its columns: base and target moved, and of each joint a constant, sine and cosine of its angle.
    Single poses far off count for nothing, as with a median.
    """
    n, dof = comparison.q.shape
    to_point = twist_transport(comparison.base_T_encoder[:, :3, :3] @ point[:3])
    joints = to_point @ comparison.jacobian
    waves = np.stack([np.ones_like(comparison.q), np.sin(comparison.q), np.cos(comparison.q)])
    of_joints = np.concatenate([joints * wave[:, None] for wave in waves], axis=2)
    placed = to_point @ placement_columns(comparison.base_T_encoder)
    every = np.concatenate([of_joints, placed], axis=2)
    total, doubts = [], []
    for part in PARTS:
        kept = np.arange(n)
        while True:
            design, wanted = every[kept, part], off[kept, part]
            basis, size, _ = np.linalg.svd(design.reshape(3 * len(kept), -1), full_matrices=False)
            basis = basis[:, size > 3 * n * np.finfo(float).eps * size[0]]
            freedom = basis.shape[0] - basis.shape[1]
            if freedom < 3 * dof:
                return None
            left = wanted - (basis @ (basis.T @ wanted.reshape(-1))).reshape(-1, 3)
            square, rows = float(np.sum(left**2)), basis.reshape(len(kept), 3, -1)
            # what leaving a pose out gains: of one that is far off, nearly all that is left
            own = np.eye(3) - rows @ rows.swapaxes(1, 2)
            gain = np.einsum("ni,nij,nj->n", left, np.linalg.pinv(own, hermitian=True), left)
            rest = max(square - gain.max(), 0.0) / (freedom - 3)
            if gain.max() <= MAX_GAIN * rest or len(kept) <= MIN_KEPT * n:
                break
            kept = np.delete(kept, np.argmax(gain))
        total.append(square / freedom)
        doubts.append(np.sqrt(2 / freedom))
    return total, float(max(doubts))


def _windows(t: Array) -> Index:
    """Where WINDOW poses follow each other without a gap: the first of each, (w,)."""
    if len(t) < WINDOW:
        return np.zeros(0, dtype=np.int64)
    close = np.lib.stride_tricks.sliding_window_view(np.diff(t) <= MAX_GAP, WINDOW - 1)
    return np.flatnonzero(close.all(axis=1))


def _residual_squares(t: Array, values: Array, first: Index) -> Array:
    """Sums of squares that a parabola in time leaves of (n, 6) values in each window, (w, 6)."""
    rows = first[:, None] + np.arange(WINDOW)
    at = t[rows] - t[rows].mean(axis=1, keepdims=True)
    at /= np.abs(at).max(axis=1, keepdims=True)
    basis = np.linalg.qr(np.stack([np.ones_like(at), at, at**2], axis=2))[0]
    inside = values[rows]
    left = inside - basis @ (np.swapaxes(basis, 1, 2) @ inside)
    return np.asarray(np.sum(left**2, axis=1))
