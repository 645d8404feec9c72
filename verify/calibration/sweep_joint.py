"""One sweep measured: the joint's axis, and how far it turned against its encoder."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag

from verify.calibration.sweep_axis import Axis, fit_axis
from verify.calibration.sweep_lines import Line
from verify.calibration.sweep_segments import Sweep
from verify.interim import without_base
from verify.readings import Readings
from verify.records import Array, Measurement
from verify.session import Session
from verify.systematics import sensitivities, stated

MOST_PAIRS = 150  # of one sweep, evenly spread: more only cost time


@dataclass(frozen=True, slots=True)
class SweptJoint:
    """One sweep: the joint's axis, and its turn against the encoder."""

    joint: int  # counted from 1
    frames: NDArray[np.int64]  # (n,)
    q: Array  # (n, joints), rad, readings
    axis: Axis
    by_source: Array  # (4, p), the axis's parameters by one standard deviation of each source
    gear: float  # turn about the axis over the encoder's
    gear_uncertainty: float
    nonlinearity: Array  # (n,), rad, encoder less turn, a straight line taken out
    nonlinearity_uncertainty: Array  # (n,), rad

    @property
    def span(self) -> float:
        """From the least to the largest reading, rad."""
        return float(np.ptp(self.q[:, self.joint - 1]))

    @property
    def covariance(self) -> Array:
        """Of the axis's four parameters, everything included, (4, 4)."""
        total: Array = self.axis.covariance + self.by_source @ self.by_source.T
        return total

    @property
    def line(self) -> Line:
        """The axis in the rig."""
        return Line(self.axis.direction, self.axis.point)


def fit_joint(
    session: Session, measured: list[Measurement], readings: Readings, sweep: Sweep
) -> SweptJoint:
    """Fit the axis of one sweep and compare its turn with the encoder.

    Args:
        session: rig and marker with what is stated of them; the readings' grain.
        measured: the pairs that the sweep counts in, all six degrees of freedom known.
        readings: the encoders, for their noise.
        sweep: which joint moved, when.
    """
    count = min(len(sweep.pairs), MOST_PAIRS)
    chosen = np.linspace(0, len(sweep.pairs) - 1, count).astype(int)
    seen = [measured[i] for i in sweep.pairs[chosen]]
    q = sweep.q[chosen]
    poses = [m.pose for m in seen if m.pose is not None]
    angle = q[:, sweep.joint]
    axis = fit_axis(
        np.array([p.rig_T_flange for p in poses]), np.array([p.covariance for p in poses]), angle
    )
    effects = _effects(session, seen)
    gear, gear_u, left, left_u = _against_encoder(
        axis, axis.angle_by_pose @ effects, angle, _reading_sigma(session, readings, sweep.joint)
    )
    return SweptJoint(
        joint=sweep.joint + 1,
        frames=np.array([m.frame for m in seen], dtype=np.int64),
        q=q,
        axis=axis,
        by_source=axis.by_pose @ effects,
        gear=gear,
        gear_uncertainty=gear_u,
        nonlinearity=left,
        nonlinearity_uncertainty=left_u,
    )


def _effects(session: Session, seen: list[Measurement]) -> Array:
    """How poses move by one standard deviation of everything stated, (6 n, p), rig axes."""
    rig, marker = replace(session.rig, rig_T_base=np.eye(4)), session.marker
    known = without_base(stated(rig, marker, turning=False))
    columns = np.concatenate([sensitivities(known, m, rig, marker) for m in seen])
    values, vectors = np.linalg.eigh(known.covariance)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    factor = np.asarray(block_diag(root, np.diag(np.nan_to_num(known.pan))), dtype=np.float64)
    effects: Array = columns @ factor
    return effects


def _reading_sigma(session: Session, readings: Readings, joint: int) -> float:
    """Standard uncertainty of one reading: its noise, or its grain where that hides it."""
    grain = (session.encoder_resolution or 0.0) / 12**0.5
    return max(float(readings.noise[joint]), grain)


def _against_encoder(
    axis: Axis, effects: Array, q: Array, sigma: float
) -> tuple[float, float, Array, Array]:
    """Gear ratio and what a straight line leaves, each with its standard uncertainty."""
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
    hat = np.eye(n) - design @ gain
    spread = hat @ total @ hat.T
    gear_u = float(np.sqrt((gain @ total @ gain.T)[1, 1]))
    return float(gear), gear_u, left, np.sqrt(np.diag(spread))
