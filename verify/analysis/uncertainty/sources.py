"""The sources of uncertainty of a session: what varies from pair to pair, and what does not."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

import robots
from verify.analysis.comparison import Comparison, alignment_scale, twist_transport
from verify.analysis.diagnosis.link_faults import rotation_twist, translation_twist
from verify.analysis.model import JointErrorModel, SessionComparison, clock_effect, pan_columns
from verify.core.records import Array

PIXELS, INSTRUMENT, SKEW = "pixels", "instrument", "camera skew"
NOISE, RESOLUTION, TIME_STAMPS = "readings' noise", "encoder resolution", "encoder time stamps"
AUTOCORRELATION, LACK_OF_FIT, CAUSES = "autocorrelation", "lack of fit", "causes found"
CLOCK, PAN, ALIGNMENT = "clock", "pan angle", "alignment of the two instants"
ROBOT_TABLE = "robot table"
INFINITE_DOF = float("inf")  # degrees of freedom of what is stated without any
TABLE_ENTRIES = (("a", "mm"), ("d", "mm"), ("alpha", "deg"))


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
    noise = plain.reading_noise
    poses = PIXELS if session.instrument is None else INSTRUMENT
    found = [
        RandomSource(poses, "A", carry @ track.covariance_pixels[plain.index] @ turned),
        RandomSource(SKEW, "A", carry @ (scale * track.covariance_alignment)[plain.index] @ turned),
        RandomSource(NOISE, "A", _propagate(plain.jacobian, noise**2)),
    ]
    if session.encoder_resolution is not None:
        variance = np.full(len(noise), session.encoder_resolution**2 / 12)
        found.append(RandomSource(RESOLUTION, "B", _propagate(plain.jacobian, variance)))
    if session.encoder_time_standard_uncertainty is not None:
        speed = np.einsum("nij,nj->ni", plain.jacobian, plain.rate)
        speed = speed * session.encoder_time_standard_uncertainty
        found.append(RandomSource(TIME_STAMPS, "B", speed[:, :, None] * speed[:, None, :]))
    found += [RandomSource(PAN, "B", c) for c in pan_reading_covariance(plain, compared)]
    grown = model.comparison.covariance - plain.covariance
    return [*found, RandomSource(AUTOCORRELATION, "A", grown)]


def _propagate(jacobian: Array, variance: Array) -> Array:
    spread: Array = np.einsum("nij,j,nkj->nik", jacobian, variance, jacobian)
    return spread


def pan_reading_covariance(comparison: Comparison, compared: SessionComparison) -> Iterator[Array]:
    """Spread (n, 6, 6) of xi by pan readings that no two pairs share, a camera each."""
    track, systematics = compared.track, compared.systematics
    for side in (0, 1):
        sigma = systematics.pan[side]
        if sigma > 0 and not pan_columns(comparison, track, systematics, side).shape[2]:
            effect = comparison.systematic[:, :, len(systematics.names) + side] * sigma
            yield effect[:, :, None] * effect[:, None, :]


def systematic_sources(comparison: Comparison, compared: SessionComparison) -> SystematicSources:
    """List everything stated or estimated once for the session, parameter by parameter.

    The comparison is the model's; the session's rig tells which parameters share the calibration's
    degrees of freedom.
    """
    rig, clock, systematics = compared.session.rig, compared.clock, compared.systematics
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
    for side, camera in enumerate(("left", "right")):
        group = pan_columns(comparison, compared.track, systematics, side)  # of unit variance
        sigma = systematics.pan[side]
        names += [f"{camera}.pan_deg"] * group.shape[2]  # one error a reading, all of one size
        sources += [PAN] * group.shape[2]
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
