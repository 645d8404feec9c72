"""Looks at the flange's LEDs while the arm stands, picture by picture, beside the loop."""

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

MIN_PICTURES, MAX_PICTURES = 8, 16  # pictures of one look: measured ones, and those that are tried
SETTLING_TIME = 0.3  # s from the arm's arrival: it may lag behind its encoders, or swing
TOL_REST = 3e-4  # rad by which encoders of an arm at rest may differ: two of MELFA's last digits
TOL_SAME_ORDER = 1e-5  # rad: orders that differ by less are one

SubmitMeasurement = Callable[[Callable[[], FlangeMeasurement]], Future[FlangeMeasurement]]


def run_now(work: Callable[[], FlangeMeasurement]) -> Future[FlangeMeasurement]:
    """Do it now; where time stands still meanwhile, as in the simulated cell."""
    done: Future[FlangeMeasurement] = Future()
    done.set_result(work())
    return done


@dataclass(slots=True)
class _RestSightings:
    """What was gathered since the arm has come to rest."""

    q: Array  # (n,), rad, as ordered
    since: float  # s
    read: list[Array] = field(default_factory=list)  # (n,), rad each
    sights: list[FlangeMeasurement] = field(default_factory=list)
    taken: float = -np.inf  # s, when the newest of the pictures was taken


class FlangeWatch:
    """Measures where the flange is, picture by picture, and keeps nobody waiting.

    Args:
        arm: that carries the LEDs.
        rig: the cameras, and the robot's place in the rig.
        marker: the LEDs.
        submit: does the measuring; at once, or beside the loop.
    """

    def __init__(
        self, arm: DhArm, rig: Rig, marker: Marker, submit: SubmitMeasurement = run_now
    ) -> None:
        self._arm, self._rig, self._marker, self._submit = arm, rig, marker, submit
        self._pair: StereoPair | None = None
        self._reading: EncoderReading | None = None
        self._look: _RestSightings | None = None
        self._working: Future[FlangeMeasurement] | None = None

    def update(self, pair: StereoPair | None, reading: EncoderReading | None) -> None:
        """Take the newest pictures and joint angles; None where there are no new ones."""
        self._pair = self._pair if pair is None else pair
        self._reading = self._reading if reading is None else reading

    def forget(self) -> None:
        """The arm moves: what was gathered counts no more."""
        self._look = None

    def gather(
        self, now: float, q: Array
    ) -> tuple[tuple[FlangeMeasurement, ...], Array | None] | None:
        """Go on with a look at an arm that stands.

        Args:
            now: s, on the pictures' clock.
            q: (n,), rad, where it was ordered to stand.

        Returns:
            The sights, and the mean of the joint angles read meanwhile, (n,), rad, None where they
            show that it did not stand; or None: there is more to gather.
        """
        if self._look is None or np.abs(self._look.q - q).max() > TOL_SAME_ORDER:
            self._look = _RestSightings(np.array(q), now)
        look = self._look
        if self._reading is not None and self._reading.t_host >= look.since + SETTLING_TIME:
            look.read.append(self._reading.q)
        if self._working is not None:
            if not self._working.done():
                return None
            sight, self._working = self._working.result(), None
            if sight.t >= look.since + SETTLING_TIME:  # else of the look before this one
                look.sights.append(sight)
        measured = sum(sight.base_T_flange is not None for sight in look.sights)
        if measured >= MIN_PICTURES or len(look.sights) >= MAX_PICTURES:
            return tuple(look.sights), _resting_angles(look.read)
        pair = self._pair
        if (
            pair is not None
            and pair.t_left >= look.since + SETTLING_TIME
            and pair.t_left > look.taken
        ):
            look.taken = pair.t_left
            self._working = self._submit(partial(self._measured, pair, look.q))
        return None

    def _measured(self, pair: StereoPair, q: Array) -> FlangeMeasurement:
        """Measure a pair by itself, and say what came of it."""
        told = self._rig.rig_T_base @ robots.forward(self._arm, q)
        seen = measure_resting_flange(pair, self._rig, self._marker, told)
        if seen.status != "measured" or seen.pose is None or seen.pose.known_dof < 6:
            status = seen.status if seen.status != "measured" else "too_few_leds"
            return FlangeMeasurement(pair.t_left, status, None, None, None)
        away = np.abs(difference(seen.pose.rig_T_flange, told))
        if (
            away[:3].max() > SEARCH_RADIUS or away[3:].max() > MAX_ROTATION
        ):  # LEDs taken for one another
            return FlangeMeasurement(pair.t_left, "implausible", None, None, None)
        return self._sight(seen, seen.pose)

    def _sight(self, seen: Measurement, pose: Pose) -> FlangeMeasurement:
        base_T_rig = invert(self._rig.rig_T_base)
        turn = np.kron(np.eye(2), base_T_rig[:3, :3])
        given = stated_systematics(self._rig, self._marker, turning=False)
        columns = sensitivities(given, seen, self._rig, self._marker)
        # the base's own place is a part of what is looked for
        chosen = [i for i, name in enumerate(given.names) if not name.startswith("robot_base.")]
        by, spread = columns[:, chosen], given.covariance[np.ix_(chosen, chosen)]
        pans = columns[:, len(given.names) :] * np.nan_to_num(given.pan)
        return FlangeMeasurement(
            seen.t,
            seen.status,
            base_T_rig @ pose.rig_T_flange,
            turn @ pose.covariance @ turn.T,
            by @ spread @ by.T + pans @ pans.T,
        )


def _resting_angles(read: list[Array]) -> Array | None:
    """The mean of joint angles that agree; None: they do not, or there are none."""
    if not read or np.ptp(read, axis=0).max() > TOL_REST:
        return None
    mean: Array = np.mean(read, axis=0)
    return mean
