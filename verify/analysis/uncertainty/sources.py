"""The sources of uncertainty of a session: what varies from pair to pair, and what does not."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

import robots
from robots.transforms import cross_matrix
from verify.analysis.clock.estimate import ClockEstimate
from verify.analysis.comparison import Comparison, alignment_scale, propagate, twist_transport
from verify.analysis.diagnosis.link_faults import rotation_twist, translation_twist
from verify.analysis.instrument import CALIBRATION_SOURCE, instrument_sensitivities
from verify.analysis.instrument import NOISE as INSTRUMENT_NOISE
from verify.analysis.model import JointErrorModel, SessionComparison, clock_effect, pan_columns
from verify.core.records import POSE_NAMES, SIDES, Array
from verify.core.rig import Rig
from verify.measurement.sensitivities import AXES
from verify.measurement.systematics import (
    PAN_ANGLE,
    PAN_AXES,
    PAN_READINGS,
    SOURCES,
    Systematics,
    sensitivities,
)
from verify.measurement.track import Track

PIXELS, INSTRUMENT, SKEW = "pixels", "instrument", "camera skew"
NOISE, RESOLUTION, TIME_STAMPS = "readings' noise", "encoder resolution", "encoder time stamps"
AUTOCORRELATION, LACK_OF_FIT, CAUSES = "autocorrelation", "lack of fit", "causes found"
CLOCK, ALIGNMENT = "clock", "alignment of the two instants"
TILT = "tilted camera"
ROBOT_TABLE = "robot table"
INFINITE_DOF = float("inf")  # degrees of freedom of what is stated without any
TABLE_ENTRIES = (("a", "mm"), ("d", "mm"), ("alpha", "deg"))
# what is asked after of a source that states no uncertainty: m, rad, s, shares
LENGTH, ANGLE, DELAY, BASELINE, SCALE = 1e-3, float(np.radians(0.1)), 1e-3, 1e-2, 1e-3
AXIS_TILT, AXIS_SHIFT = float(np.radians(1.0)), 1e-2  # rad, m
MIN_EFFECT = 1e-9  # rad: less is rounding


@dataclass(frozen=True, slots=True)
class RandomSource:
    """A source that varies from pair to pair and averages out."""

    source: str
    type: str  # A: from this session's own data; B: stated
    covariance: Array  # (n, 6, 6), of xi


@dataclass(frozen=True, slots=True)
class SystematicSources:
    """Sources that do not average out, p of them; known together by one covariance."""

    names: tuple[str, ...]  # each with its unit as suffix
    sources: tuple[str, ...]  # the line of the budget that each belongs to
    types: tuple[str, ...]  # A or B
    degrees: Array  # (p,), degrees of freedom
    columns: Array  # (n, 6, p), d xi / d parameter, SI
    covariance: Array  # (p, p), SI


@dataclass(frozen=True, slots=True)
class UnstatedEffect:
    """What an error that nobody states an uncertainty of would do."""

    source: str  # whose
    error: str  # "a baseline off by 1 %", "1 mm", "0.1°"
    joint: int  # from 0: whose mean error, or offset, it would move the most
    moved: float  # rad, by how much

    def __str__(self) -> str:
        return f"{self.error} would move joint {self.joint + 1} by {np.degrees(self.moved):.2g}°"


def unstated_sources(systematics: Systematics, clock: ClockEstimate) -> tuple[str, ...]:
    """Sources that state no uncertainty and are taken as exact."""
    if clock.standard_uncertainty is None:  # given without one, or not observable
        return (*systematics.uncounted, CLOCK)
    return systematics.uncounted


def unstated_effects(
    comparison: Comparison,
    compared: SessionComparison,
    exact: tuple[str, ...],
    by_pair: Array,
) -> list[UnstatedEffect]:
    """What an error of each source in `exact` would move, the largest first.

    The comparison is the model's; `by_pair` (n, j, 6) takes xi to the mean errors. What the
    session fits beside the joints moves nothing.
    """
    effects = []
    for source in exact:
        for error, columns in _unstated_columns(source, comparison, compared):
            moved = np.abs(np.einsum("njk,nkp->jp", by_pair, columns)).max(axis=1, initial=0.0)
            joint = int(np.argmax(np.nan_to_num(moved)))
            if moved[joint] > MIN_EFFECT:
                effects.append(UnstatedEffect(source, error, joint, float(moved[joint])))
    return sorted(effects, key=lambda effect: -effect.moved)


def _unstated_columns(
    source: str, comparison: Comparison, compared: SessionComparison
) -> Iterator[tuple[str, Array]]:
    """The errors that are asked after of a source, and what each does to xi, (n, 6, ways)."""
    session = compared.session

    def of(*names: str) -> Array:
        asked = replace(compared.systematics, names=names)
        moves = sensitivities if session.instrument is None else instrument_sensitivities
        there = [compared.measurements[i] for i in comparison.index.tolist()]
        columns = np.array([moves(asked, m, session.rig, session.marker) for m in there])
        place = compared.track.base_T_flange[comparison.index, :3, 3]
        carry = twist_transport(comparison.base_T_measured[:, :3, 3] - place)
        return np.asarray(carry @ columns[:, :, : len(names)])

    head = {name: key for key, name in SOURCES.items()}.get(source, "body")
    if source == CLOCK:
        yield "1 ms", DELAY * clock_effect(comparison)
    elif source == ROBOT_TABLE:
        names, columns = robot_table_columns(session.arm, comparison)
        long = np.array([name.endswith("_mm") for name in names], dtype=np.bool_)
        yield "a length off by 1 mm", LENGTH * columns[:, :, long]
        yield "a twist off by 0.1°", ANGLE * columns[:, :, ~long]
    elif source == CALIBRATION_SOURCE:
        yield (
            "0.1 % of scale",
            SCALE * np.pad(comparison.base_T_measured[:, :3, [3]], ((0, 0), (0, 3), (0, 0))),
        )
    elif source == "rig":
        half = (session.rig.right.pan_center - session.rig.left.pan_center)[0] * BASELINE / 2
        apart = of("left.pan_center_x_mm", "right.pan_center_x_mm") @ np.array([[-half], [half]])
        yield "a baseline off by 1 %", apart
        yield "a camera turned by 0.1°", ANGLE * of(*PAN_READINGS)
    elif source == PAN_ANGLE:
        yield "0.1°", ANGLE * of(*PAN_READINGS)
    elif source == PAN_AXES:
        yield from axis_columns(session.rig, of)
    elif head in ("led", "centre"):
        places = [f"led.{name}.{axis}_mm" for name in session.marker.names for axis in AXES]
        yield "an LED off by 1 mm", LENGTH * of(*places)
    elif source != INSTRUMENT_NOISE:
        yield "1 mm", LENGTH * of(*(f"{head}.{axis}" for axis in POSE_NAMES[:3]))
        yield "0.1°", ANGLE * of(*(f"{head}.{axis}" for axis in POSE_NAMES[3:]))


def axis_columns(rig: Rig, of: Callable[..., Array]) -> Iterator[tuple[str, Array]]:
    """Axes off by what a base may be, of cameras that stand where they stood at rig.toml's pan."""
    tilts, shifts = [], []
    for side, camera in zip(SIDES, (rig.left, rig.right), strict=True):
        axis, mount, place, centre = (
            of(*(f"{side}.{key.format(at)}" for at in AXES))
            for key in ("pan_axis_r{}_deg", "mount_r{}_deg", "mount_{}_mm", "pan_center_{}_mm")
        )
        rig_R_table = camera.rig_T_camera(camera.pan)[:3, :3] @ camera.mount[:3, :3].T
        mount = mount - place @ cross_matrix(camera.mount[:3, 3])  # the whole mount turns back
        tilts.append((axis + mount @ (np.eye(3) - rig_R_table.T))[:, :, ::2])
        shifts.append((place - centre @ rig_R_table)[:, :, ::2])
    yield "an axis off by 1°", AXIS_TILT * np.concatenate(tilts, axis=2)
    yield "a camera 10 mm off its axis", AXIS_SHIFT * np.concatenate(shifts, axis=2)


def random_sources(model: JointErrorModel, compared: SessionComparison) -> list[RandomSource]:
    """Take apart what varies from pair to pair; the parts add up to the model's covariance.

    In the model pairs that repeat each other's errors count for fewer; `compared` is the session
    before that, its Jacobian taken at the readings.
    """
    session, track, plain = compared.session, compared.track, compared.comparison
    moved = plain.base_T_measured[:, :3, 3] - track.base_T_flange[plain.index, :3, 3]
    carry = twist_transport(moved)
    turned = np.swapaxes(carry, 1, 2)
    scale = alignment_scale(track)[:, None, None]
    poses = PIXELS if session.instrument is None else INSTRUMENT
    found = [
        RandomSource(poses, "A", carry @ track.covariance_pixels[plain.index] @ turned),
        RandomSource(SKEW, "A", carry @ (scale * track.covariance_alignment)[plain.index] @ turned),
        RandomSource(NOISE, "A", propagate(plain.jacobian, plain.local_noise**2)),
    ]
    if session.encoder_resolution is not None:
        variance = np.full((1, session.arm.dof), session.encoder_resolution**2 / 12)
        found.append(RandomSource(RESOLUTION, "B", propagate(plain.jacobian, variance)))
    if session.encoder_time_standard_uncertainty is not None:
        speed = np.einsum("nij,nj->ni", plain.jacobian, plain.rate)
        speed = speed * session.encoder_time_standard_uncertainty
        found.append(RandomSource(TIME_STAMPS, "B", speed[:, :, None] * speed[:, None, :]))
    found += [RandomSource(PAN_ANGLE, "B", c) for c in pan_reading_covariance(plain, compared)]
    grown = model.comparison.covariance - plain.covariance
    return [*found, RandomSource(AUTOCORRELATION, "A", grown)]


def pan_reading_covariance(comparison: Comparison, compared: SessionComparison) -> Iterator[Array]:
    """Spread (n, 6, 6) of xi by pan readings that no two pairs share, a camera each."""
    track, systematics = compared.track, compared.systematics
    for side in (0, 1):
        sigma = systematics.pan[side]
        if sigma > 0 and not pan_columns(comparison, track, systematics, side).shape[2]:
            effect = comparison.systematic[:, :, len(systematics.names) + side] * sigma
            yield effect[:, :, None] * effect[:, None, :]


def systematic_sources(
    comparison: Comparison, track: Track, clock: ClockEstimate, systematics: Systematics, rig: Rig
) -> SystematicSources:
    """List everything stated or estimated once for the session, parameter by parameter.

    The comparison is the model's; the rig tells which parameters share the calibration's degrees of
    freedom.
    """
    count = len(systematics.names)
    given = set(rig.covariance.parameters) if rig.covariance is not None else set()
    names, sources = list(systematics.names), list(systematics.sources)
    degrees = [systematics.degrees_of_freedom if n in given else INFINITE_DOF for n in names]
    types = ["B"] * count
    columns, variances = [comparison.systematic[:, :, :count]], []
    u = clock.standard_uncertainty
    if u and clock.source in ("given", "arrival"):  # else it is a free column of the fit
        names.append("clock_s")
        sources.append(CLOCK)
        types.append("B")
        columns.append(clock_effect(comparison))
        variances.append(np.array([u**2]))
    if comparison.alignment_error.any():
        names.append("alignment_1")
        sources.append(ALIGNMENT)
        types.append("B")  # of a size that the neighbours show, in a sense that nobody knows
        columns.append(comparison.alignment_error[:, :, None])
        variances.append(np.ones(1))
    tilts = comparison.tilt.shape[2]  # the pictures show their size, but not which camera
    names += [f"tilt{k + 1}_1" for k in range(tilts)]
    sources += [TILT] * tilts
    types += ["B"] * tilts
    columns.append(comparison.tilt)
    variances.append(np.ones(tilts))
    for side, camera in enumerate(("left", "right")):
        group = pan_columns(comparison, track, systematics, side)  # of unit variance
        sigma = systematics.pan[side]
        names += [f"{camera}.pan_deg"] * group.shape[2]  # one error a reading, all of one size
        sources += [PAN_ANGLE] * group.shape[2]
        types += ["B"] * group.shape[2]
        columns.append(group / sigma if group.shape[2] else group)
        variances.append(np.full(group.shape[2], sigma**2))
    spread = np.zeros((len(names), len(names)))
    spread[:count, :count] = systematics.covariance
    rest = np.concatenate([np.zeros(0), *variances])
    spread[range(count, len(names)), range(count, len(names))] = rest
    degrees += [INFINITE_DOF] * len(rest)
    return SystematicSources(
        names=tuple(names),
        sources=tuple(sources),
        types=tuple(types),
        degrees=np.array(degrees),
        columns=np.concatenate(columns, axis=2),
        covariance=spread,
    )


def robot_table_columns(arm: robots.Arm, comparison: Comparison) -> tuple[tuple[str, ...], Array]:
    """What the lengths and angles of the robot's own table do to xi: names, and (n, 6, p).

    Without a DH table (a URDF) there are none; a joint's offset is its error itself.
    """
    if not isinstance(arm, robots.DhArm):
        return (), np.zeros((len(comparison), 6, 0))
    frames = robots.link_frames(arm, comparison.q)
    tip, links = frames[:, -1, :3, 3], range(arm.dof)
    along = [translation_twist(frames[:, i + 1, :3, 0]) for i in links]
    down = [translation_twist(frames[:, i, :3, 2]) for i in links]
    twisted = [
        rotation_twist(frames[:, i + 1, :3, 0], tip - frames[:, i + 1, :3, 3]) for i in links
    ]
    names = [f"{key}{i + 1}_{unit}" for key, unit in TABLE_ENTRIES for i in links]
    return tuple(names), np.concatenate([*along, *down, *twisted], axis=2)
