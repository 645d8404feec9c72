"""Measure the flange's LEDs while the arm stands, picture by picture, without delaying the loop."""

from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass, field
from functools import partial

import numpy as np

import robots
from robots import DhArm
from robots.transforms import difference, invert
from verify.core.fiducials import Marker
from verify.core.records import Array, Measurement, Pose, StereoPair
from verify.core.rig import Rig
from verify.devices.protocols import EncoderReading
from verify.grasping.tool_offset.offset import (
    MAX_ROTATION,
    SEARCH_RADIUS,
    FlangeMeasurement,
    measure_resting_flange,
)
from verify.measurement.systematics import sensitivities, stated_systematics

MIN_PICTURES, MAX_PICTURES = 8, 16  # of one measurement: measured ones, and tried ones
SETTLING_TIME = 0.3  # s from the arm's arrival: it may lag behind its encoders, or swing
TOL_REST = 3e-4  # rad by which encoders of an arm at rest may differ: two of MELFA's last digits
TOL_SAME_ORDER = 1e-5  # rad: orders that differ by less are one

SubmitMeasurement = Callable[[Callable[[], FlangeMeasurement]], Future[FlangeMeasurement]]


def run_now(work: Callable[[], FlangeMeasurement]) -> Future[FlangeMeasurement]:
    """Measure at once: for the simulated cell, where no time passes meanwhile."""
    done: Future[FlangeMeasurement] = Future()
    done.set_result(work())
    return done


@dataclass(slots=True)
class _RestSightings:
    """Measurements since the arm has come to rest."""

    q: Array  # (n,), rad, as ordered
    since: float  # s
    read: list[Array] = field(default_factory=list)  # (n,), rad each
    sights: list[FlangeMeasurement] = field(default_factory=list)
    taken: float = -np.inf  # s, when the newest of the pictures was taken


class FlangeWatch:
    """Measures where the flange is, picture by picture."""

    def __init__(
        self, arm: DhArm, rig: Rig, marker: Marker, submit: SubmitMeasurement = run_now
    ) -> None:
        self._arm, self._rig, self._marker, self._submit = arm, rig, marker, submit
        self._pair: StereoPair | None = None
        self._reading: EncoderReading | None = None
        self._rest: _RestSightings | None = None
        self._working: Future[FlangeMeasurement] | None = None

    def update(self, pair: StereoPair | None, reading: EncoderReading | None) -> None:
        """Take the newest pictures and joint angles; None where there are no new ones."""
        self._pair = self._pair if pair is None else pair
        self._reading = self._reading if reading is None else reading

    def forget(self) -> None:
        """Drop what was gathered: the arm moves."""
        self._rest = None

    def gather(
        self, now: float, q: Array
    ) -> tuple[tuple[FlangeMeasurement, ...], Array | None] | None:
        """Continue the measurement of an arm that was ordered to stand at q, (n,), rad.

        Returns the measurements, and the mean of the joint angles read meanwhile, (n,), rad, None
        where they show that it did not stand; or None: there is more to gather.
        """
        if self._rest is None or np.abs(self._rest.q - q).max() > TOL_SAME_ORDER:
            self._rest = _RestSightings(np.array(q), now)
        rest = self._rest
        if self._reading is not None and self._reading.t_host >= rest.since + SETTLING_TIME:
            rest.read.append(self._reading.q)
        if self._working is not None:
            if not self._working.done():
                return None
            sight, self._working = self._working.result(), None
            if sight.t >= rest.since + SETTLING_TIME:  # else of the rest before this one
                rest.sights.append(sight)
        measured = sum(sight.base_T_flange is not None for sight in rest.sights)
        if measured >= MIN_PICTURES or len(rest.sights) >= MAX_PICTURES:
            moved = not rest.read or np.ptp(rest.read, axis=0).max() > TOL_REST
            return tuple(rest.sights), None if moved else np.asarray(np.mean(rest.read, axis=0))
        pair, earliest = self._pair, rest.since + SETTLING_TIME
        if pair is not None and pair.t_left >= earliest and pair.t_left > rest.taken:
            rest.taken = pair.t_left
            self._working = self._submit(partial(self._measured, pair, rest.q))
        return None

    def _measured(self, pair: StereoPair, q: Array) -> FlangeMeasurement:
        ordered = self._rig.rig_T_base @ robots.forward(self._arm, q)
        measurement = measure_resting_flange(pair, self._rig, self._marker, ordered)
        pose = measurement.pose
        if measurement.status != "measured":
            return FlangeMeasurement(pair.t_left, measurement.status)
        if pose is None or pose.known_dof < 6:
            return FlangeMeasurement(pair.t_left, "too_few_leds")
        away = np.abs(difference(pose.rig_T_flange, ordered))
        # beyond these, LEDs were taken for one another
        if away[:3].max() > SEARCH_RADIUS or away[3:].max() > MAX_ROTATION:
            return FlangeMeasurement(pair.t_left, "implausible")
        return self._sight(measurement, pose)

    def _sight(self, measurement: Measurement, pose: Pose) -> FlangeMeasurement:
        base_T_rig = invert(self._rig.rig_T_base)
        turn = np.kron(np.eye(2), base_T_rig[:3, :3])
        given = stated_systematics(self._rig, self._marker, turning=False)
        columns = sensitivities(given, measurement, self._rig, self._marker)
        # the base's own place is part of what is measured
        chosen = [i for i, name in enumerate(given.names) if not name.startswith("robot_base.")]
        by, spread = columns[:, chosen], given.covariance[np.ix_(chosen, chosen)]
        pans = columns[:, len(given.names) :] * np.nan_to_num(given.pan)
        return FlangeMeasurement(
            measurement.t,
            measurement.status,
            base_T_rig @ pose.rig_T_flange,
            turn @ pose.covariance @ turn.T,
            by @ spread @ by.T + pans @ pans.T,
        )
