"""A run without pictures: true LED images with noise go through the chain as detected spots."""

import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import count, cycle

import numpy as np
import pytest

import robots
from tests.support.drawn_rig import believed
from tests.support.leds.scene import make_spots
from tests.support.motions import ARM, HOME
from tests.support.motions import PERIOD as JOINT_PERIOD
from tests.support.scene import project
from verify.core.fiducials import Marker
from verify.core.records import Array, Image, Spots, StereoPair
from verify.core.rig import Rig
from verify.devices.protocols import EncoderReading
from verify.live.alarms.joints import AlarmLimits, JointAlarms
from verify.live.bracketing import Bracketing, MeasuredPair
from verify.live.buffers import ReadingBuffer
from verify.live.clock import ESTIMATE_PERIOD, ClockKeeper, Estimator, LiveClock, estimate_offset
from verify.live.joint_row import Evidence, JointRow
from verify.live.protocols import Alarm, MonitoredRobot
from verify.measurement import chain
from verify.measurement.chain import Setup, measure

SIGMA = 0.05  # px: what a webcam's spot is known to
SWING = np.deg2rad([5.0, 4.0, 5.0, 8.0, 8.0, 12.0])
PERIOD = np.array([7.9, 5.7, 6.1, 4.3, 5.3, 3.7])  # s
READ_EVERY = 0.01  # s
OFFSET = 0.137  # s, of the controller's clock
NOISE = np.deg2rad(0.003)  # of a reading


class Picture(np.ndarray):
    """An even picture that carries the spots it would show."""

    spots: Array


def picture(spots: Array) -> Image:
    """Make one; each differs from the one before, as a camera's do."""
    made = np.broadcast_to(np.uint8(next(LEVELS)), (720, 1280)).view(Picture)
    made.spots = spots  # type: ignore[attr-defined]
    return made


LEVELS = cycle(range(7))  # an odd number: of both cameras in turn


def seen_spots(image: Image, _windows: Array | None = None, **_: bool) -> Spots:
    """Stand in for detection."""
    centre: Array = image.spots  # type: ignore[attr-defined]
    return make_spots(centre, np.full((len(centre), 3), 200.0), sigma=SIGMA)


@contextmanager
def without_pictures() -> Iterator[None]:
    """Let the chain take the pictures' spots as they are."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(chain, "detect", seen_spots)
        yield


@dataclass
class SpotRun:
    """A robot that swings all its joints, watched at a steady rate."""

    rig: Rig
    marker: Marker
    rate: float = 30.0
    skew: float = 0.0  # s
    jump: tuple[float, int, float] | None = None  # s, joint from 1, rad
    seed: int = 1
    estimator: Estimator = estimate_offset

    def __post_init__(self) -> None:
        self.arm = ARM
        self._chance = np.random.default_rng(self.seed)

    def joints(self, t: Array) -> Array:
        return HOME + SWING * np.sin(2 * np.pi * np.asarray(t)[..., None] / PERIOD + np.arange(6))

    def spots(self, side: int, t: float) -> Array:
        camera = (self.rig.left, self.rig.right)[side]
        flange = self.rig.rig_T_base @ robots.forward(self.arm, self.joints(np.array(t)))
        points = self.marker.leds @ flange[:3, :3].T + flange[:3, 3]
        pixels = project(camera, camera.pan, points)
        return pixels + self._chance.normal(0, SIGMA, pixels.shape)

    def pairs(self, seconds: float) -> Iterator[StereoPair]:
        for frame in range(int(seconds * self.rate)):
            t = 1.0 + frame / self.rate
            pan = self.rig.left.pan, self.rig.right.pan
            left, right = picture(self.spots(0, t)), picture(self.spots(1, t + self.skew))
            yield StereoPair(frame, t, t + self.skew, *pan, left, right)

    def reading(self, number: int) -> EncoderReading:
        t = number * READ_EVERY
        q = self.joints(np.array(t)) + self._chance.normal(0, NOISE, 6)
        if self.jump is not None and t >= self.jump[0]:
            q[self.jump[1] - 1] += self.jump[2]
        return EncoderReading(t - OFFSET, t + 0.001, 50e-6, 0, q)

    def watch(
        self, seconds: float, limits: AlarmLimits
    ) -> tuple[list[JointRow], list[Alarm], ClockKeeper]:
        """Measure, compare and watch, as the loop does, as fast as it goes."""
        book = ReadingBuffer()
        subject = MonitoredRobot(self.arm, self.rig, self.marker, None)
        keeper = ClockKeeper(self.arm, self.rig, book, None, self.estimator)
        bracketing = Bracketing(subject, book, keeper, turning=False)
        watch = JointAlarms(6, limits, count(1))
        rows: list[JointRow] = []
        alarms: list[Alarm] = []
        number, due = 0, ESTIMATE_PERIOD
        with without_pictures():
            setup = Setup(self.rig, self.marker)
            for measured in measure(self.pairs(seconds), setup, causal=True):
                if measured.settled:
                    continue
                while number * READ_EVERY < measured.t + 3 * READ_EVERY:
                    book.add(self.reading(number))
                    number += 1
                keeper.add(measured)
                if measured.t > due:
                    keeper.estimate_now()
                    due = measured.t + ESTIMATE_PERIOD
                waited = bracketing.wait(MeasuredPair(measured, 0.0, 0.0), 0, lambda _frame: None)
                row, _ = bracketing.compare([waited])[0]
                rows.append(row)
                alarms += watch.take(row, measured.t)
        return rows, alarms, keeper


def facing_rig() -> tuple[Rig, Marker]:
    """A rig that looks at the middle of the swing from 0.6 m, and four LEDs."""
    return believed(doubts=False)


RATE = 30.0
POSE_SIGMA = np.array([7e-5] * 3 + [math.radians(0.04)] * 3)  # m, rad: what pixels leave of a pose
CLOCK = LiveClock(0.1, 1e-4, "estimated")
PRIORS = 8


def streamed(
    seconds: float,
    seed: int,
    *,
    bias: float = 1.0,
    stated: float = 4.0,
    repeating: float = 0.0,
    jump: tuple[float, int, float] | None = None,
) -> Iterator[JointRow]:
    """Rows as the loop makes them, numbers only.

    Args:
        seconds: of them.
        seed: for what is drawn.
        bias: standard deviations of what rig, base and LEDs are off.
        stated: how large such a deviation is, against a pair's noise.
        repeating: correlation of a pair's noise with the one before.
        jump: s, joint counted from 1, rad.
    """
    chance = np.random.default_rng(seed)
    t = np.arange(int(seconds * RATE)) / RATE
    q = HOME + SWING * np.sin(2 * np.pi * t[:, None] / JOINT_PERIOD + np.arange(6))
    jacobian = robots.jacobian(ARM, q)
    priors = chance.normal(0, 1, (6, PRIORS)) * (stated * POSE_SIGMA)[:, None]
    off = bias * chance.choice([-1.0, 1.0], PRIORS)
    sway = np.linspace(0.5, 1.5, PRIORS)
    noise = np.zeros(6)
    for i in range(len(t)):
        noise = repeating * noise + math.sqrt(1 - repeating**2) * chance.normal(0, 1, 6)
        columns = priors * (1 + 0.3 * np.sin(t[i] * sway))
        xi = POSE_SIGMA * noise + columns @ off
        if jump is not None and t[i] >= jump[0]:
            xi = xi + jacobian[i][:, jump[1] - 1] * jump[2]
        evidence = Evidence(
            xi=xi,
            jacobian=jacobian[i],
            noise=np.diag(POSE_SIGMA**2),
            alignment=np.zeros((6, 6)),
            prior=columns,
            clock=np.zeros(6),
            clock_uncertainty=1e-4,
            determined=np.eye(6),
        )
        error = np.linalg.solve(jacobian[i], xi)
        inverse = np.linalg.inv(jacobian[i])
        spread = inverse @ (np.diag(POSE_SIGMA**2) + columns @ columns.T) @ inverse.T
        yield row(float(t[i]), error, np.sqrt(np.diag(spread)), evidence)


def row(t: float, error: Array, uncertainty: Array, evidence: Evidence | None) -> JointRow:
    nothing = np.full(6, np.nan)
    return JointRow(
        0, t, "measured", 4, nothing, nothing, error, uncertainty, error, CLOCK, evidence=evidence
    )
