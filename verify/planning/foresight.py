"""Predict what the measuring chain and the analysis would state of a motion before it is recorded.

Model: the spots of both pictures are projected without noise,

    spot = project(camera, rig_T_base @ forward(arm, q(t + row delay)) @ led), covariance sigma^2 I

and handed with readings q(t) + noise to the code that measures and analyses sessions: the
prediction is what `verify run` will state, not a model of it.

What joint offsets do not explain adds to the uncertainty of a clock that is found from the motion,
and a world without errors has nothing of it. So N_WORLDS worlds are drawn about the stated errors,
and the clock is estimated in each.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

import robots
from robots.transforms import displace
from verify.analysis import joint_errors
from verify.analysis.clock.estimate import ClockEstimate, estimate_clock
from verify.analysis.comparison import Comparison, compare
from verify.analysis.model import (
    JointErrorModel,
    Observability,
    add_pan_noise,
    build_model,
    prior_columns,
    visibility,
)
from verify.analysis.uncertainty.budget import (
    BudgetLine,
    calibration_variance,
    pair_sensitivities,
    systematic_lines,
)
from verify.analysis.uncertainty.sources import systematic_sources
from verify.core.readings import Readings
from verify.core.records import Array, Image, Measurement, Noise, Spots, StereoPair
from verify.core.rig import Rig
from verify.measurement.alignment import MAX_GAP, spot_instants
from verify.measurement.chain import Setup, measure
from verify.measurement.systematics import Systematics, sensitivities, stated_systematics
from verify.measurement.track import Track, collect_track
from verify.planning.constraints import PredictedView, visible_leds
from verify.planning.request import PlanningSetup, SessionConditions

N_WORLDS = 5
MIN_BORDER_PX = 8.0  # a spot nearer to the rim is cut off
READING_MARGIN = 0.5  # s of readings before the first pair and after the last
BURST_TIME = 0.2  # s of readings either side of a single visit
PEAK_DN = 200.0  # DN, of every LED: none is brighter than another
Motion = Callable[[Array], Array]  # s (n,) to joint angles (n, j), rad


def simulate_clock(
    track: Track,
    arm: robots.Arm,
    readings: Readings,
    systematics: Systematics,
    rng: np.random.Generator,
) -> ClockEstimate:
    """Estimate the clock in worlds drawn about the stated errors, from poses without noise.

    Readings are on the cameras' clock. Returns the offset of the perfect world, 0 but for the
    readings' noise, with the median uncertainty of all; the perfect world's alone where the LEDs
    leave a turn open.
    """
    perfect = estimate_clock(track, arm, readings)
    full = bool((track.known_dof == 6).all())
    if perfect.source != "estimated" or not full:  # with turns left open the search takes minutes
        return perfect
    exact = ClockEstimate(0.0, None, "given", np.zeros((0, 2)))
    comparison = compare(track, arm, readings, 0.0)
    columns = prior_columns(comparison, track, exact, systematics)
    roots = np.linalg.cholesky(track.covariance_pixels[comparison.index])
    sizes = []
    for _ in range(N_WORLDS):
        off = columns @ rng.standard_normal(columns.shape[2])
        noise = rng.standard_normal((len(comparison), 6, 1))
        twist = np.zeros((len(track), 6))
        twist[comparison.index] = off + (roots @ noise)[:, :, 0]
        moved = replace(track, base_T_flange=displace(track.base_T_flange, twist))
        found = estimate_clock(moved, arm, readings)
        # one that is not found in some world is as good as unknown there
        sizes.append(found.standard_uncertainty or np.inf)
    typical = float(np.median(sizes))
    if not np.isfinite(typical):
        return replace(perfect, offset=0.0, standard_uncertainty=None, source="none")
    return replace(perfect, standard_uncertainty=typical)


@dataclass(frozen=True, slots=True)
class PredictedSession:
    """The results of a session of n pairs, of which m are measured."""

    t: Array  # (n,), s
    q: Array  # (n, j), rad
    rig: Rig
    measurements: list[Measurement]
    track: Track  # m pairs
    systematics: Systematics
    clock: ClockEstimate
    comparison: Comparison
    model: JointErrorModel


@dataclass(frozen=True, slots=True)
class PredictedAnalysis:
    """The analysis of a predicted session."""

    random: Array  # (j,), rad, standard uncertainty of the means from what averages out
    coverage_factor: Array  # (j,), of the means
    systematic: tuple[BudgetLine, ...]  # what of the means' uncertainty does not average out
    resolved: joint_errors.ResolvedErrors
    visibility: Observability


def simulate_session(
    setup: PlanningSetup,
    motion: Motion,
    t: Array,
    conditions: SessionConditions,
    view_angle: float,
    rng: np.random.Generator,
) -> PredictedSession | None:
    """Simulate a session without errors; None where no pair could be measured.

    The left camera takes its pictures at t (n,), s; LEDs are seen within `view_angle`, rad, from
    the flange's z. The readings are noisy: the analysis takes the noise's size from them.
    """
    pairs = _SyntheticPairs(setup, motion, conditions, view_angle)
    measurements = list(measure(pairs.pairs(t), pairs.setup()))
    systematics = stated_systematics(setup.rig, setup.marker, turning=False)
    effects = [
        sensitivities(systematics, m, setup.rig, setup.marker)
        for m in measurements
        if m.status == "measured"
    ]
    track = collect_track(measurements, setup.rig, effects)
    if not len(track):
        return None
    readings = _readings(motion, t, conditions, setup.arm.dof, rng)
    clock = (
        simulate_clock(track, setup.arm, readings, systematics, rng)
        if conditions.clock_uncertainty is None
        else ClockEstimate(0.0, conditions.clock_uncertainty, "given", np.zeros((0, 2)))
    )
    comparison = compare(track, setup.arm, readings, clock.offset)
    comparison = add_pan_noise(comparison, track, systematics)
    model = build_model(comparison, track, setup.rig, setup.marker, clock, systematics)
    return PredictedSession(
        t, motion(t), setup.rig, measurements, track, systematics, clock, comparison, model
    )


def estimate_means(session: PredictedSession) -> PredictedAnalysis:
    """Estimate mean errors and their uncertainty as `verify run` does."""
    model = session.model
    resolved = joint_errors.resolve_errors(model)
    by_row = joint_errors.mean_sensitivities(model, resolved)
    by_pair = pair_sensitivities(model, by_row)
    held = systematic_sources(
        model.comparison, session.track, session.clock, session.systematics, session.rig
    )
    random = np.sum(by_row**2, axis=1)  # whitened rows have unit variance
    degrees = joint_errors.effective_degrees(
        np.diag(resolved.mean_covariance), random,
        max(float(resolved.fit.degrees_of_freedom), 1.0), *calibration_variance(held, by_pair),
    )  # fmt: skip
    factor, lines = joint_errors.coverage_factor(degrees), tuple(systematic_lines(held, by_pair))
    return PredictedAnalysis(np.sqrt(random), factor, lines, resolved, visibility(model))


class _SyntheticPairs:
    """Pairs without pictures, and the spots that would be in them.

    The chain asks for a pair's spots before it takes the next pair.
    """

    def __init__(
        self, setup: PlanningSetup, motion: Motion, conditions: SessionConditions, view_angle: float
    ) -> None:
        self._setup, self._motion, self._conditions = setup, motion, conditions
        self._angle = view_angle
        width, height = setup.rig.image_size
        self._blank: Image = np.broadcast_to(np.zeros(1, dtype=np.uint8), (height, width))
        self._now: tuple[Spots, Spots]

    def setup(self) -> Setup:
        return Setup(
            self._setup.rig,
            self._setup.marker,
            expected=lambda t: list(self._setup.rig.rig_T_base @ self._flange(np.array([t]))),
            detect=lambda _pair, _in_left, _in_right: self._now,
        )

    def pairs(self, t: Array) -> Iterator[StereoPair]:
        rig, skew = self._setup.rig, self._conditions.skew
        sides = [self._spots(side, t + skew * side) for side in (0, 1)]
        for i, (left, right) in enumerate(zip(*sides, strict=True)):
            self._now = left, right
            yield StereoPair(
                i, float(t[i]), float(t[i]) + skew, rig.left.pan, rig.right.pan,
                self._blank, self._blank,
            )  # fmt: skip

    def _flange(self, t: Array) -> Array:
        return robots.forward(self._setup.arm, self._motion(t))

    def _view(self, side: int, t: Array) -> PredictedView:
        return visible_leds(self._setup, self._flange(t), MIN_BORDER_PX, self._angle)[side]

    def _spots(self, side: int, t: Array) -> list[Spots]:
        """One camera's spots of all pairs; each LED at its own row's instant."""
        rig, marker = self._setup.rig, self._setup.marker
        camera = rig.right if side else rig.left
        view = self._view(side, t)
        pixels, visible = view.pixels, view.inside & view.facing & view.apart
        if camera.line_time:
            height = rig.image_size[1]
            for led in range(len(marker)):
                late = spot_instants(0.0, np.nan_to_num(pixels[:, led]), camera, height)
                pixels[:, led] = self._view(side, t + late).pixels[:, led]
        return [self._found(p[s]) for p, s in zip(pixels, visible, strict=True)]

    def _found(self, centre: Array) -> Spots:
        n, sigma = len(centre), self._conditions.spot_noise
        return Spots(
            centre=centre,
            covariance=np.tile(sigma**2 * np.eye(2), (n, 1, 1)),
            peak=np.full(n, PEAK_DN),
            diameter=np.full(n, 1.0),
            misfit=np.ones(n),
            saturated=np.zeros(n, dtype=bool),
            merged=np.zeros(n, dtype=bool),
            colour=np.full((n, 3), PEAK_DN),
            noise=Noise(1.0, 0.0, 0.0),
        )


def _readings(
    motion: Motion, t: Array, conditions: SessionConditions, joints: int, rng: np.random.Generator
) -> Readings:
    """The controller's readings on the cameras' clock, all along or about single visits."""
    step = 1 / conditions.reading_rate
    visits = len(t) > 1 and float(np.diff(t).min()) > MAX_GAP
    if visits:
        log = (t[:, None] + np.arange(-BURST_TIME, BURST_TIME + step / 2, step)).ravel()
    else:
        log = np.arange(t[0] - READING_MARGIN, t[-1] + READING_MARGIN, step)
    noise = conditions.reading_noise * rng.standard_normal((len(log), joints))
    return Readings(log, motion(log) + noise)
