"""Fit one joint's sweep: its axis, its turn against the encoder; and relations of two axes."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import block_diag

import robots
from verify.analysis.least_squares import autocorrelation
from verify.analysis.rig_check.check import drop_registration
from verify.analysis.sweeps import axis as circles
from verify.analysis.sweeps.segments import SweepSegment
from verify.core.readings import Readings
from verify.core.records import Array, Index, Measurement
from verify.io.session.session import Session
from verify.measurement.systematics import covariance_root, sensitivities, stated_systematics

MAX_PARALLEL_ANGLE = np.deg2rad(5.0)  # axes nearer to parallel have no common normal to speak of
STEP = 1e-6  # rad and m, of numerical derivatives: small against curvature, large against rounding
MAX_PAIRS = 150  # of one sweep, evenly spread: more only cost time


@dataclass(frozen=True, slots=True)
class AxisLine:
    """A joint's axis; the joint's angle grows by the right hand about the direction."""

    direction: Array  # (3,), unit vector
    point: Array  # (3,), m


def line_in_base(arm: robots.Arm, joint: int, q: Array) -> AxisLine:
    """The axis of a joint (counted from 0) in the base at joint angles q (n,), by the arm's table.

    The point is the axis's nearest to the flange. From the geometric Jacobian: its column holds
    the direction z and z × (p − o) for the flange p and any point o of the axis.
    """
    column = robots.jacobian(arm, q)[:, joint]
    return AxisLine(column[3:], robots.forward(arm, q)[:3, 3] + np.cross(column[3:], column[:3]))


def are_parallel(one: AxisLine, other: AxisLine) -> bool:
    """Whether two lines count as parallel (or run against each other)."""
    return bool(
        np.linalg.norm(np.cross(one.direction, other.direction)) < np.sin(MAX_PARALLEL_ANGLE)
    )


def angle_between(one: AxisLine, other: AxisLine) -> float:
    """Angle between two directions, rad, 0 to pi: the twist between axes."""
    sine = np.linalg.norm(np.cross(one.direction, other.direction))
    return float(np.arctan2(sine, one.direction @ other.direction))


def distance_between(one: AxisLine, other: AxisLine) -> float:
    """Distance of two lines along their common normal, m: the link length.

    Lines that are not parallel have it signed along one × other, so that noise about zero
    averages to zero; parallel ones have it across their mean direction.
    """
    apart = other.point - one.point
    if not are_parallel(one, other):
        normal = np.cross(one.direction, other.direction)
        return float(apart @ normal / np.linalg.norm(normal))
    mean = one.direction + np.sign(one.direction @ other.direction) * other.direction
    mean = mean / np.linalg.norm(mean)
    return float(np.linalg.norm(apart - mean * (mean @ apart)))


def tilt_between(one: AxisLine, other: AxisLine) -> Array:
    """How far other's direction leaves one's line, (3,): a vector that parallel axes have at 0."""
    return other.direction * np.sign(one.direction @ other.direction) - one.direction


def line_derivative(
    function: Callable[[AxisLine, AxisLine], Array | float],
    lines: tuple[AxisLine, AxisLine],
    across: tuple[Array, Array],
) -> Array:
    """Derivative of a function of two lines by their eight parameters, (…, 8), numerically.

    Each line has four: small steps of its direction, then of its point, along its `across` (2, 3).
    """

    def at(step: Array) -> Array:
        moved = []
        for line, a, (turn, shift) in zip(lines, across, step.reshape(2, 2, 2), strict=True):
            direction = line.direction + turn @ a
            moved.append(AxisLine(direction / np.linalg.norm(direction), line.point + shift @ a))
        return np.asarray(function(*moved), dtype=np.float64)

    return np.stack([(at(row) - at(-row)) / (2 * STEP) for row in STEP * np.eye(8)], axis=-1)


@dataclass(frozen=True, slots=True)
class SweepAxis(AxisLine):
    """A line in the rig, along which the joint's angle grows, and the turn about it.

    The point is the axis's nearest to the middle of the flange's path. Its four parameters are
    small: two of the direction along `across`, and two of the point along the same two directions.
    """

    across: Array  # (2, 3), unit vectors at right angles to the direction
    covariance: Array  # (4, 4), rad and m: direction, then point, along `across`
    by_pose: Array  # (4, 6 n), how the measured poses move the axis
    angle: Array  # (n,), rad, turned about the axis; the mean is the encoder's
    angle_covariance: Array  # (n, n)
    angle_by_pose: Array  # (n, 6 n)
    noise: float  # by what the poses' stated uncertainty was multiplied, >= 1


def fit_axis(poses: Array, covariance: Array, q: Array) -> SweepAxis:
    """Find the line about which n >= 6 poses (n, 4, 4), rig_T_flange, turn.

    The circle-point fit of the analysis with all points of the flange at once and one free angle a
    pair: encoders only start it and set the angles' mean. No table of the arm enters.

    The covariance (n, 6, 6) is in m and rad, its perturbation on the left in rig axes. The joint's
    encoder q (n,), rad, starts the fit and orients the axis; its mean is the zero that the angles
    need.
    """
    n = len(poses)
    swept = circles.SweepData(poses, covariance, np.zeros((n, 6, 0)), q, np.zeros(n))
    # a free angle a pair, less the mean of all, which the start pose holds
    terms = np.linalg.svd(np.ones((1, n)))[2][1:].T
    state = circles.fit_circles(swept, terms).state
    # a point by the path's middle: far from it the direction's doubt would move the point
    shift = state.direction @ (poses[:, :3, 3].mean(axis=0) - state.point)
    found = circles.fit_circles(
        swept, terms, replace(state, point=state.point + shift * state.direction)
    )
    state = found.state
    degrees = 6 * n - (circles.N_FREE + n - 1)
    chi2 = float(np.sum(found.residual**2))
    scatter = max(1.0, chi2 / degrees) * float(np.mean(autocorrelation(found.residual)))
    covariance = found.solved.covariance
    gain = (covariance @ found.rows.T).reshape(-1, n, 6)
    by_pose = np.einsum("knj,nji->kni", gain, found.white).reshape(-1, 6 * n)
    return SweepAxis(
        direction=state.direction,
        point=state.point,
        across=circles.perpendiculars(state.direction),
        covariance=covariance[: circles.N_LINE, : circles.N_LINE] * scatter,
        by_pose=by_pose[: circles.N_LINE],
        angle=swept.q - terms @ state.value,
        angle_covariance=terms @ covariance[circles.N_FREE :, circles.N_FREE :] @ terms.T * scatter,
        angle_by_pose=-terms @ by_pose[circles.N_FREE :],
        noise=float(np.sqrt(scatter)),
    )


@dataclass(frozen=True, slots=True)
class JointSweepResult:
    """One sweep: the joint's axis, and its turn against the encoder."""

    joint: int  # counted from 1
    frames: Index  # (n,)
    q: Array  # (n, joints), rad, readings
    axis: SweepAxis
    by_source: Array  # (4, p), the axis's parameters by one standard deviation of each source
    gear: float  # turn about the axis over the encoder's
    gear_uncertainty: float
    nonlinearity: Array  # (n,), rad, encoder less turn, a straight line taken out

    @property
    def span(self) -> float:
        """From the least to the largest reading, rad."""
        return float(np.ptp(self.q[:, self.joint - 1]))


def fit_joint(
    session: Session, measured: list[Measurement], readings: Readings, sweep: SweepSegment
) -> JointSweepResult:
    """Fit the axis of one sweep and compare its turn with the encoder.

    Pairs that the sweep counts in have all six degrees of freedom known.
    """
    chosen = np.linspace(0, len(sweep.rows) - 1, min(len(sweep.rows), MAX_PAIRS)).astype(int)
    seen = [measured[i] for i in sweep.rows[chosen]]
    q = sweep.q[chosen]
    poses = [m.pose for m in seen if m.pose is not None]
    angle = q[:, sweep.joint]
    axis = fit_axis(
        np.array([p.rig_T_flange for p in poses]), np.array([p.covariance for p in poses]), angle
    )
    effects = _effects(session, seen)
    # of one reading: its noise, or its grain where that hides it
    sigma = max(float(readings.noise[sweep.joint]), (session.encoder_resolution or 0.0) / 12**0.5)
    gear, gear_u, left = _gear_ratio(axis, axis.angle_by_pose @ effects, angle, sigma)
    return JointSweepResult(
        joint=sweep.joint + 1,
        frames=np.array([m.frame for m in seen], dtype=np.int64),
        q=q,
        axis=axis,
        by_source=axis.by_pose @ effects,
        gear=gear,
        gear_uncertainty=gear_u,
        nonlinearity=left,
    )


def _effects(session: Session, seen: list[Measurement]) -> Array:
    """How poses move by one standard deviation of everything stated, (6 n, p), rig axes."""
    rig, marker = replace(session.rig, rig_T_base=np.eye(4)), session.marker
    known = drop_registration(stated_systematics(rig, marker, turning=False))
    columns = np.concatenate([sensitivities(known, m, rig, marker) for m in seen])
    pan = np.diag(np.nan_to_num(known.pan))
    return columns @ np.asarray(block_diag(covariance_root(known.covariance), pan))


def _gear_ratio(
    axis: SweepAxis, effects: Array, q: Array, sigma: float
) -> tuple[float, float, Array]:
    """Gear ratio with its standard uncertainty, and what a straight line leaves, (n,), rad."""
    n = len(q)
    varying = axis.angle_covariance + sigma**2 * np.eye(n)
    design = np.stack([np.ones(n), q - q.mean()], axis=1)
    # the angles' mean was set to the encoder's and has no variance of its own; one that all angles
    # share changes no slope and keeps the matrix regular
    shared = float(np.trace(varying)) / n
    solved = np.linalg.solve(varying + shared * np.ones((n, n)), design)
    gain = np.linalg.solve(design.T @ solved, solved.T)
    offset, gear = gain @ axis.angle
    left = offset + design[:, 1] * gear - axis.angle
    total = varying + effects @ effects.T
    gear_u = float(np.sqrt((gain @ total @ gain.T)[1, 1]))
    return float(gear), gear_u, left
