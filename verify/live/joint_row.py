"""One measured pair set against the encoders: the recorded session's own steps on a single row."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.linalg import block_diag

import robots
from verify.comparison import Comparison, compare
from verify.joints import solve_joints
from verify.judgement.model import clock_effect
from verify.live.clock_live import Clock
from verify.marker import Marker
from verify.readings import Readings
from verify.records import Array, Measurement
from verify.rig import Rig
from verify.systematics import Systematics, root, sensitivities, stated
from verify.track import collect

NO_ENCODER, UNREACHABLE = "no_encoder", "unreachable"


@dataclass(frozen=True, slots=True)
class JointRow:
    """What one pair says of the joints; arm with j joints. Angles in rad; nan where not told."""

    frame: int
    t: float  # s, cameras' clock
    status: str  # as in frames.csv
    leds_seen: int
    measured: Array  # (j,)
    encoder: Array  # (j,)
    error: Array  # (j,), reading less measured
    uncertainty: Array  # (j,), standard, of the error from all sources
    single: Array  # (j,), error where no singularity couples the joint
    clock: Clock | None
    base_T_measured: Array | None = None  # (4, 4)
    base_T_encoder: Array | None = None  # (4, 4)
    evidence: "Evidence | None" = None


@dataclass(frozen=True, slots=True)
class Evidence:
    """The same as the alarm weighs it: a twist, what joints and doubts do to it, its spread."""

    xi: Array  # (6,), m and rad: readings' pose less measured
    jacobian: Array  # (6, j)
    noise: Array  # (6, 6), new with every pair: pixels and readings
    alignment: Array  # (6, 6), while the arm speeds up: bringing two instants to one
    prior: Array  # (6, p), columns of unit variance: what rig, base and LEDs state
    clock: Array  # (6,), d xi / d clock offset
    clock_uncertainty: float  # s
    determined: Array  # (6, d)


@dataclass(frozen=True, slots=True)
class Scales:
    """What the station states of the readings."""

    resolution: float | None  # rad
    time_uncertainty: float | None  # s


class Comparer:
    """Sets measurements against readings.

    Args:
        arm: the robot.
        rig: the cameras.
        marker: the LEDs.
        scales: what is stated of the readings.
        turning: pan readings vary or carry an uncertainty.
    """

    def __init__(
        self, arm: robots.Arm, rig: Rig, marker: Marker, scales: Scales, *, turning: bool
    ) -> None:
        self.arm, self._rig, self._marker, self._scales = arm, rig, marker, scales
        self.systematics: Systematics = stated(rig, marker, turning)
        self._root = _columns(self.systematics)

    def row(self, measurement: Measurement, readings: Readings | None, clock: Clock) -> JointRow:
        """Compare one pair.

        Args:
            measurement: what the pictures gave.
            readings: about its instant; None where there are none.
            clock: to place them on the cameras' clock.

        Returns:
            The row; its status says why there is no error where there is none.
        """
        if measurement.status != "measured":
            return self._empty(measurement, measurement.status, clock)
        effect = sensitivities(self.systematics, measurement, self._rig, self._marker)
        track = collect([measurement], self._rig, [effect])
        known = None if readings is None else readings.known(track.t - clock.offset)
        if readings is None or known is None or not known[0]:
            return self._measured_alone(measurement, track.base_T_flange[0], clock)
        comparison = compare(
            track,
            self.arm,
            readings,
            clock.offset,
            resolution=self._scales.resolution,
            time_uncertainty=self._scales.time_uncertainty,
            known=known,
        )
        return self._compared(measurement, comparison, clock, track.covariance_alignment[0])

    def without(self, measurement: Measurement) -> JointRow:
        """Word a pair for which there is no clock yet, as no reading has ever come."""
        status = NO_ENCODER if measurement.status == "measured" else measurement.status
        return self._empty(measurement, status, None)

    def _compared(
        self, measurement: Measurement, comparison: Comparison, clock: Clock, alignment: Array
    ) -> JointRow:
        joints = solve_joints(comparison, self.arm)
        if not joints.reached[0]:
            return self._empty(measurement, UNREACHABLE, clock, comparison)
        prior = comparison.systematic[0] @ self._root
        effect = clock_effect(comparison)[0, :, 0]
        aligned = alignment if comparison.determined[0].shape[1] == 6 else np.zeros((6, 6))
        doubt = clock.standard_uncertainty or 0.0
        inverse = joints.inverse[0]
        variance = np.diag(joints.covariance[0]) + np.sum((inverse @ prior) ** 2, axis=1)
        variance = variance + (inverse @ effect * doubt) ** 2
        uncertainty = np.where(np.isnan(joints.q[0]), np.nan, np.sqrt(variance))
        return JointRow(
            frame=measurement.frame,
            t=measurement.t,
            status=measurement.status,
            leds_seen=measurement.leds_seen,
            measured=joints.q[0],
            encoder=comparison.q[0],
            error=joints.error[0],
            uncertainty=uncertainty,
            single=joints.single[0],
            clock=clock,
            base_T_measured=comparison.base_T_measured[0],
            base_T_encoder=comparison.base_T_encoder[0],
            evidence=Evidence(
                xi=comparison.xi[0],
                jacobian=comparison.jacobian[0],
                noise=comparison.covariance[0] - aligned,
                alignment=aligned,
                prior=prior,
                clock=effect,
                clock_uncertainty=doubt,
                determined=comparison.determined[0],
            ),
        )

    def _measured_alone(
        self, measurement: Measurement, base_T_flange: Array, clock: Clock
    ) -> JointRow:
        return self._empty(measurement, NO_ENCODER, clock, base_T_measured=base_T_flange)

    def _empty(
        self,
        measurement: Measurement,
        status: str,
        clock: Clock | None,
        comparison: Comparison | None = None,
        **known: Any,
    ) -> JointRow:
        nothing = np.full(self.arm.dof, np.nan)
        if comparison is not None:
            known["base_T_measured"] = comparison.base_T_measured[0]
            known["base_T_encoder"] = comparison.base_T_encoder[0]
        encoder = nothing if comparison is None else comparison.q[0]
        return JointRow(
            frame=measurement.frame,
            t=measurement.t,
            status=status,
            leds_seen=measurement.leds_seen,
            measured=nothing,
            encoder=encoder,
            error=nothing,
            uncertainty=nothing,
            single=nothing,
            clock=clock,
            **known,
        )


def _columns(systematics: Systematics) -> Array:
    """Carry the parameters' sensitivities, pan readings last, to columns of unit variance."""
    pan = np.diag(np.nan_to_num(systematics.pan))
    return np.asarray(block_diag(root(systematics.covariance), pan), dtype=np.float64)
