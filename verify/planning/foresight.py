"""A session before it is recorded: what the chain and the judgement would make of a motion.

The spots that the pictures would show are handed to the very code that measures sessions and judges
robots, without noise but with its stated size; so what is predicted is what `verify run` will
state, not a model of it.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

import robots
from verify.alignment import LONGEST_GAP, spot_instants
from verify.clock import ClockEstimate
from verify.comparison import Comparison, compare
from verify.joints import solve_joints
from verify.judgement.means import JointErrors, Means, mean_errors
from verify.judgement.model import Model, build, clock_effect, with_pan_noise
from verify.judgement.resolved import resolve
from verify.judgement.visibility import Visibility, visibility
from verify.measurement import Setup, measure
from verify.planning.clock_foreseen import foreseen_clock
from verify.planning.view import View, views
from verify.planning.wishes import Bench, Conditions
from verify.readings import Readings
from verify.records import Array, Image, Measurement, Noise, Spots, StereoPair
from verify.systematics import Systematics, sensitivities, stated
from verify.track import Track, collect

Motion = Callable[[Array], Array]  # s (n,) to joint angles (n, j), rad
RIM_PX = 8.0  # a spot nearer to the rim is cut off
AROUND = 0.5  # s of readings before the first pair and after the last
BURST = 0.2  # s of readings either side of a single visit
PEAK = 200.0  # DN, of every LED: none is brighter than another


@dataclass(frozen=True, slots=True)
class Foreseen:
    """What a session of n pairs, of which m are measured, would give."""

    t: Array  # (n,), s
    q: Array  # (n, j), rad
    measurements: list[Measurement]
    track: Track  # m pairs
    systematics: Systematics
    clock: ClockEstimate
    comparison: Comparison
    model: Model


@dataclass(frozen=True, slots=True)
class Judged:
    """What the judgement would state of it."""

    means: Means
    visibility: Visibility
    errors: JointErrors
    inverse: Array  # (m, j, 6), d joints / d pose


def foresee(
    bench: Bench,
    motion: Motion,
    t: Array,
    conditions: Conditions,
    view_angle: float,
    rng: np.random.Generator,
) -> Foreseen | None:
    """Play a session in which nothing is wrong.

    Args:
        bench: arm, rig, marker.
        motion: joint angles over time.
        t: (n,), s, when the left camera takes its pictures.
        conditions: of cameras and encoders.
        view_angle: rad from the flange's z within which LEDs are seen.
        rng: for the readings' noise, whose size the judgement takes from the readings.

    Returns:
        What would be found; None where no pair could be measured.
    """
    play = _Play(bench, motion, conditions, view_angle)
    measurements = list(measure(play.pairs(t), play.setup()))
    systematics = stated(bench.rig, bench.marker, turning=False)
    effects = [
        sensitivities(systematics, m, bench.rig, bench.marker)
        for m in measurements
        if m.status == "measured"
    ]
    track = collect(measurements, bench.rig, effects)
    if not len(track):
        return None
    readings = _readings(motion, t, conditions, bench.arm.dof, rng)
    clock = (
        foreseen_clock(track, bench.arm, readings, systematics, rng)
        if conditions.clock_uncertainty is None
        else ClockEstimate(0.0, conditions.clock_uncertainty, "given", np.zeros((0, 2)))
    )
    comparison = compare(track, bench.arm, readings, clock.offset)
    comparison = with_pan_noise(comparison, track, systematics)
    model = build(comparison, track, bench.rig, bench.marker, clock, systematics)
    return Foreseen(t, motion(t), measurements, track, systematics, clock, comparison, model)


def judge(foreseen: Foreseen, arm: robots.Arm) -> Judged:
    """State means and their uncertainty as `verify run` does."""
    model, clock = foreseen.model, foreseen.clock
    comparison = foreseen.comparison
    joints = solve_joints(comparison, arm)
    inverse = joints.inverse
    errors = JointErrors(
        error=joints.single,
        covariance=inverse @ comparison.covariance @ np.swapaxes(inverse, 1, 2),
        systematic=inverse @ model.prior_columns,
        clock=(inverse @ clock_effect(comparison))[:, :, 0],
    )
    estimated = clock.standard_uncertainty if clock.source == "estimated" else None
    means = mean_errors(model, errors, resolve(model), estimated, foreseen.systematics)
    return Judged(means, visibility(model), errors, inverse)


class _Play:
    """Pairs without pictures, and the spots that would be in them.

    The chain asks for a pair's spots before it takes the next pair.
    """

    def __init__(
        self, bench: Bench, motion: Motion, conditions: Conditions, view_angle: float
    ) -> None:
        self._bench, self._motion, self._conditions = bench, motion, conditions
        self._angle = view_angle
        width, height = bench.rig.image_size
        self._blank: Image = np.broadcast_to(np.zeros(1, dtype=np.uint8), (height, width))
        self._now: tuple[Spots, Spots]

    def setup(self) -> Setup:
        return Setup(
            self._bench.rig,
            self._bench.marker,
            expected=lambda t: list(self._bench.rig.rig_T_base @ self._flange(np.array([t]))),
            detect=lambda _left, _right, _in_left, _in_right: self._now,
        )

    def pairs(self, t: Array) -> Iterator[StereoPair]:
        rig, skew = self._bench.rig, self._conditions.skew
        sides = [self._spots(side, t + skew * side) for side in (0, 1)]
        for i, (left, right) in enumerate(zip(*sides, strict=True)):
            self._now = left, right
            yield StereoPair(
                i, float(t[i]), float(t[i]) + skew, rig.left.pan, rig.right.pan,
                self._blank, self._blank,
            )  # fmt: skip

    def _flange(self, t: Array) -> Array:
        return robots.forward(self._bench.arm, self._motion(t))

    def _looked(self, side: int, t: Array) -> View:
        return views(self._bench, self._flange(t), RIM_PX, self._angle)[side]

    def _spots(self, side: int, t: Array) -> list[Spots]:
        """One camera's spots of all pairs; each LED at its own row's instant."""
        rig, marker = self._bench.rig, self._bench.marker
        camera = rig.right if side else rig.left
        view = self._looked(side, t)
        pixels, seen = view.pixels, view.seen
        if camera.line_time:
            height = rig.image_size[1]
            for led in range(len(marker)):
                own = np.nan_to_num(pixels[:, led])
                late = spot_instants(0.0, own, camera, height)
                pixels[:, led] = self._looked(side, t + late).pixels[:, led]
        return [self._found(p[s]) for p, s in zip(pixels, seen, strict=True)]

    def _found(self, centre: Array) -> Spots:
        n, sigma = len(centre), self._conditions.spot_noise
        return Spots(
            centre=centre,
            covariance=np.tile(sigma**2 * np.eye(2), (n, 1, 1)),
            peak=np.full(n, PEAK),
            diameter=np.full(n, 1.0),
            elongation=np.ones(n),
            misfit=np.ones(n),
            saturated=np.zeros(n, dtype=bool),
            merged=np.zeros(n, dtype=bool),
            colour=np.full((n, 3), PEAK),
            noise=Noise(1.0, 0.0, 0.0),
        )


def _readings(
    motion: Motion, t: Array, conditions: Conditions, joints: int, rng: np.random.Generator
) -> Readings:
    """The controller's readings on the cameras' clock, all along or about single visits."""
    step = 1 / conditions.reading_rate
    visits = len(t) > 1 and float(np.diff(t).min()) > LONGEST_GAP
    if visits:
        log = (t[:, None] + np.arange(-BURST, BURST + step / 2, step)).ravel()
    else:
        log = np.arange(t[0] - AROUND, t[-1] + AROUND, step)
    noise = conditions.reading_noise * rng.standard_normal((len(log), joints))
    return Readings(log, motion(log) + noise)
