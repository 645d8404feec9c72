"""Compare measured pairs with the encoders, each by itself, by the steps of `verify.analysis`."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.linalg import block_diag

import robots
from verify.analysis.comparison import (
    Comparison,
    JointComparison,
    ReadingUncertainty,
    compare,
    solve_joints,
)
from verify.analysis.model import clock_effect
from verify.core.fiducials import Marker
from verify.core.readings import Readings
from verify.core.records import Array, Measurement
from verify.core.rig import Rig
from verify.live.clock import LiveClock
from verify.measurement.systematics import (
    Systematics,
    covariance_root,
    sensitivities,
    stated_systematics,
)
from verify.measurement.track import collect_track, concatenate

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
    clock: LiveClock | None
    base_T_measured: Array | None = None  # (4, 4)
    base_T_encoder: Array | None = None  # (4, 4)
    evidence: "Evidence | None" = None
    settled: bool = False  # by the pairs before and after, as in a recording


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


class Comparer:
    """Sets measurements against readings.

    Args:
        arm: the robot.
        rig: the cameras.
        marker: the LEDs.
        resolution: rad, the readings' last digit, where it is stated.
        turning: pan readings vary or carry an uncertainty.
    """

    def __init__(
        self, arm: robots.Arm, rig: Rig, marker: Marker, resolution: float | None, *, turning: bool
    ) -> None:
        self.arm, self._rig, self._marker, self._resolution = arm, rig, marker, resolution
        self.systematics: Systematics = stated_systematics(rig, marker, turning)
        # the parameters' sensitivities, pan readings last, are carried to columns of unit variance
        pan = np.diag(np.nan_to_num(self.systematics.pan))
        root = block_diag(covariance_root(self.systematics.covariance), pan)
        self._root = np.asarray(root, dtype=np.float64)

    def rows(
        self,
        pairs: Sequence[tuple[Measurement, LiveClock]],
        readings: Readings | None,
        time_doubts: Array,
    ) -> list[JointRow]:
        """Compare pairs, each by itself; several take hardly longer than one.

        Args:
            pairs: what the pictures gave, each with the clock at its instant.
            readings: about their instants; None where there are none.
            time_doubts: (n,), s, standard uncertainty of the readings' times about each pair.

        Returns:
            A row a pair; its status says why there is no error where there is none.
        """
        of = [i for i, (m, _) in enumerate(pairs) if m.status == "measured"]
        measured = [pairs[i] for i in of]
        told = iter(self._rows_of_measured(measured, readings, time_doubts[of]) if of else ())
        return [
            next(told) if m.status == "measured" else self._row(m, m.status, clock)
            for m, clock in pairs
        ]

    def _rows_of_measured(
        self,
        pairs: list[tuple[Measurement, LiveClock]],
        readings: Readings | None,
        time_doubts: Array,
    ) -> list[JointRow]:
        tracks = []
        for measurement, _ in pairs:
            effect = sensitivities(self.systematics, measurement, self._rig, self._marker)
            tracks.append(collect_track([measurement], self._rig, [effect]))
        track = concatenate(tracks)
        offset = np.array([clock.offset for _, clock in pairs])
        known = np.zeros(len(pairs), dtype=bool)
        rows = {}
        if readings is not None and (known := readings.available(track.t - offset)).any():
            comparison = compare(
                track,
                self.arm,
                readings,
                offset,
                stated=ReadingUncertainty(
                    self._resolution,
                    time_doubts,
                    readings.interpolation_uncertainty(track.t - offset),
                ),
                known=known,
            )
            joints = solve_joints(comparison, self.arm)
            effects = clock_effect(comparison)[:, :, 0]
            for n, i in enumerate(comparison.index.tolist()):
                alignment = track.covariance_alignment[i]
                rows[i] = self._compared(pairs[i], comparison, joints, n, effects[n], alignment)
        for i in (~known).nonzero()[0].tolist():
            (measurement, clock), alone = pairs[i], track.base_T_flange[i]
            rows[i] = self._row(measurement, NO_ENCODER, clock, base_T_measured=alone)
        return [rows[i] for i in range(len(pairs))]

    def without(self, measurement: Measurement) -> JointRow:
        """Word a pair for which there is no clock yet, as no reading has ever come."""
        status = NO_ENCODER if measurement.status == "measured" else measurement.status
        return self._row(measurement, status, None)

    def _compared(
        self,
        pair: tuple[Measurement, LiveClock],
        comparison: Comparison,
        joints: JointComparison,
        n: int,
        effect: Array,
        alignment: Array,
    ) -> JointRow:
        """Word row n of a comparison; effect (6,): what a second of clock offset does."""
        measurement, clock = pair
        known = {
            "base_T_measured": comparison.base_T_measured[n],
            "base_T_encoder": comparison.base_T_encoder[n],
            "encoder": comparison.q[n],
        }
        if not joints.reached[n]:
            return self._row(measurement, UNREACHABLE, clock, **known)
        prior = comparison.systematic[n] @ self._root
        aligned = alignment if comparison.determined[n].shape[1] == 6 else np.zeros((6, 6))
        doubt = clock.standard_uncertainty or 0.0
        inverse = joints.inverse[n]
        held, shifted = inverse @ prior, inverse @ effect * doubt
        variance = joints.covariance[n].diagonal() + (held * held).sum(axis=1) + shifted**2
        uncertainty = np.where(np.isnan(joints.q[n]), np.nan, np.sqrt(variance))
        return self._row(
            measurement,
            measurement.status,
            clock,
            **known,
            measured=joints.q[n],
            error=joints.error[n],
            uncertainty=uncertainty,
            single=joints.single[n],
            evidence=Evidence(
                xi=comparison.xi[n],
                jacobian=comparison.jacobian[n],
                noise=comparison.covariance[n] - aligned,
                alignment=aligned,
                prior=prior,
                clock=effect,
                clock_uncertainty=doubt,
                determined=comparison.determined[n],
            ),
        )

    def _row(
        self, measurement: Measurement, status: str, clock: LiveClock | None, **known: Any
    ) -> JointRow:
        """Word what is known of a pair; angles that are not are nan."""
        nothing = np.full(self.arm.dof, np.nan)
        angles = ("measured", "encoder", "error", "uncertainty", "single")
        return JointRow(
            frame=measurement.frame,
            t=measurement.t,
            status=status,
            leds_seen=measurement.leds_seen,
            clock=clock,
            settled=measurement.settled,
            **dict.fromkeys(angles, nothing) | known,
        )
