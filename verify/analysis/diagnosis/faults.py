"""Fault models of single joints and of the set-up: what a unit of each does to every pair.

Signs and zeros are those of docs/results.md: error = reading less true angle. A column is whitened
as the session's rows are, and holds what the registration left of a fault that was already there.
Columns of a camera that is late or was moved are made of what a turn about its pan axis does to a
pose, the largest part of its effect on depth.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from verify.analysis.comparison import Comparison, base_motion, body_motion
from verify.analysis.model import MIN_SPEED_SIGMA, JointErrorModel, clock_effect
from verify.core.records import Array
from verify.core.rig import Rig

Name = tuple[str, int | None, str | None]
Turn = tuple[str, int]  # of a camera: kind and variant
Wave = tuple[int, float, float]  # a turn, and coefficients of cosine and sine, rad
MAX_OFFSET = np.deg2rad(45.0)  # of an encoder's zero: more is another branch or another robot
# beyond this, first order says nothing, and a column is what rounding leaves; m, rad, ratio
MAX_SIZE = {"deg": np.deg2rad(20.0), "mm": 0.05, "ratio": 0.3}
MAX_SHIFT = 1.0  # m, of base or LED body, whose effect has no other order
# units of faults as they are told, in a SI unit
UNIT_SCALES = {
    "deg": 180 / np.pi,
    "deg/m": 180 / np.pi,
    "deg/h": 3600 * 180 / np.pi,
    "mm": 1e3,
    "s": 1.0,
    "ppm": 1e6,
    "ratio": 1.0,
    "": 1.0,  # of what no single figure tells
}
MIN_SPAN = np.deg2rad(2.0)  # a joint that turns less shows its offset and nothing else
MIN_PAIRS_PER_DIRECTION = 3
MIN_LEVER = 1e-3  # m: shorter ones are rounding
MIN_LEVER_RATIO = 0.5  # of the longest: a lever that varies less pulls like an offset
# Below this much of a wave, sine and cosine are a parabola: an offset and a gain in disguise.
MIN_SPAN_ONE_WAVE = np.deg2rad(60.0)  # of one wave a turn, as the resolved error has it
MIN_SPAN_WAVES = np.deg2rad(270.0)  # of several a turn, which must show that they come back
KNOTS = 8  # of a camera that creeps unevenly
WHOLE_POSE = 6  # degrees of freedom
MIN_PAIRS_PER_WAVE = 2  # of what is sought: their mean, as pairs do not lie evenly
MAX_WAVES_SOUGHT = 120  # a turn, of what is sought
WAVES_STEP = 4.0  # rad, by which the numbers sought differ over the span: most is seen between two
# Of a joint with a wave every whole number is tried: few pairs a wave may tell it, as they do not
# lie evenly, and what explains a short span as well is to be known.
MIN_SPAN_ANY_WAVE = np.deg2rad(60.0)
MIN_PAIRS_ANY_WAVE = 0.5
MAX_WAVES = 360
MAX_WAVE_SLOPE = 0.8  # of an error by its joint's angle: near 1, a reading has several angles
MAX_STEPS_ANGLE = 30


@dataclass(frozen=True, slots=True)
class Fault:
    """A fault that might be: of one joint (1-based), or a common one (None)."""

    kind: str
    joint: int | None
    unit: str  # of its value in summary.json
    columns: Array  # (r, p), whitened, what a SI unit of each of its p coefficients does
    parameter: str | None = None  # of a link: a2, d4, alpha1, beta3
    per_turn: int | None = None  # of an eccentricity
    about: tuple[Wave, ...] = ()  # of an eccentricity: its joint's waves in the angle it is laid by
    variant: int = 0  # of its name: side where a backlash's play rests, ±1; camera that creeps
    shape: Array | None = None  # (n, p), of a joint: its error at each pair by a unit of each
    begin: float | None = None  # s, cameras' clock; None: it was there before the session
    instants: int = 1  # at which it might have begun

    @property
    def name(self) -> Name:
        """What a diagnosis says of it; other waves a turn, variants or begins are named alike."""
        return self.kind, self.joint, self.parameter

    @property
    def largest(self) -> Array:
        """Largest coefficients that may be told, (p,), SI; infinite where there is no bound."""
        if self.freedom == WHOLE_POSE and self.unit == "mm":  # three shifts and three turns
            return np.repeat([MAX_SHIFT, MAX_SIZE["deg"]], 3)
        if self.kind == "offset":
            return np.full(1, MAX_OFFSET)
        if self.unit not in MAX_SIZE and self.shape is not None and self.shape.any():
            return np.asarray(MAX_SIZE["deg"] / np.abs(self.shape).max(axis=0))  # of its error
        return np.full(self.freedom, MAX_SIZE.get(self.unit, np.inf))

    @property
    def freedom(self) -> int:
        """Number of its coefficients."""
        return int(self.columns.shape[1])

    def schwarz(self, rows: int) -> float:
        """What Schwarz's criterion asks for its coefficients and for its begin, in chi-squared.

        An instant is one of so many, and the data fix it to a pair: it costs twice the logarithm of
        their number. Source: Zhang and Siegmund, Biometrics 63, 2007.
        """
        return self.freedom * float(np.log(max(rows, 2))) + 2 * float(np.log(self.instants))


def fault_figures(
    fault: Fault, values: Array, covariance: Array
) -> tuple[float, float, dict[str, float]]:
    """A fault's size, its standard uncertainty, and what else there is to say of it, all SI.

    From the p coefficients' values (p,) and covariance (p, p). Of several coefficients the size is
    the length (of a displacement its shift alone; nan of what no single figure tells); the rest,
    rad: the phase of an eccentricity, the turn of a displacement.
    """
    if not fault.unit:
        return float("nan"), float("nan"), {}
    if fault.freedom == 1 or fault.kind == "camera_drift":  # of a creep: at the last pair
        # a gain's column is the reading: of the true angle, which is smaller, its share is larger
        true = 1 - values[-1] if fault.kind == "gain" else 1.0
        return float(values[-1] / true), float(np.sqrt(covariance[-1, -1]) / true**2), {}
    if fault.kind == "eccentricity":
        size, u = _size_uncertainty(values, covariance)
        return size, u, {"phase": float(np.arctan2(values[1], values[0]) / (fault.per_turn or 1))}
    shift, u = _size_uncertainty(values[:3], covariance[:3, :3])
    return shift, u, {"turn": float(np.linalg.norm(values[3:]))}


def _size_uncertainty(values: Array, covariance: Array) -> tuple[float, float]:
    size = float(np.linalg.norm(values))
    along = values / size if size > 0 else np.zeros_like(values)
    return size, float(np.sqrt(along @ covariance @ along))


def joint_faults(model: JointErrorModel, j: int) -> Iterator[Fault]:
    """Faults of one joint (from 0) that its motion can show at all."""
    comparison, joint = model.comparison, j + 1

    def fault(kind: str, unit: str, shape: Array) -> Fault:
        return Fault(kind, joint, unit, shape_columns(model, j, shape), shape=shape)

    elapsed = comparison.elapsed[:, None]
    yield fault("offset", "deg", np.ones_like(elapsed))
    yield from _by_angle(model, j)
    direction = comparison.direction[:, [j]]
    if min(np.sum(direction > 0), np.sum(direction < 0)) >= MIN_PAIRS_PER_DIRECTION:
        yield fault("backlash", "deg", direction / 2)
        for side in (1, -1) if np.sum(direction == 0) >= MIN_PAIRS_PER_DIRECTION else ():
            resting = np.where(direction == 0, side, direction)
            yield replace(fault("backlash", "deg", resting / 2), variant=side)
    # what hangs below pulls with its horizontal lever; an elastic joint reads more than it turned
    lever = comparison.jacobian[:, 2, [j]]
    longest = float(np.abs(lever).max(initial=0.0))
    if longest > MIN_LEVER and np.ptp(lever) > MIN_LEVER_RATIO * longest:
        yield fault("compliance", "deg/m", lever)
    # readings that lag behind those of the other joints; at one speed, like an offset
    rate = comparison.rate[:, [j]]
    if comparison.timed and rate.std() > MIN_SPEED_SIGMA * np.sqrt(comparison.rate_variance[j]):
        yield fault("latency", "s", -rate)
    if comparison.timed and np.ptp(elapsed) > 0:
        column = model.joints[:, [j]] * elapsed[model.white.pair]
        yield Fault("drift", joint, "deg/h", column, shape=elapsed)


def _by_angle(model: JointErrorModel, j: int) -> Iterator[Fault]:
    """What changes with the joint's angle alone: gain, and waves of every number a turn."""
    q = model.comparison.q[:, j]
    span = float(np.ptp(q))
    if span <= MIN_SPAN:
        return
    yield Fault("gain", j + 1, "ratio", shape_columns(model, j, q[:, None]), shape=q[:, None])
    yield from waves_of(model, j, _waves_sought(len(q), span))


def _waves_sought(pairs: int, span: float) -> list[int]:
    """Numbers a turn so close that no wave hides between two of them."""
    turns = span / (2 * np.pi)
    last = min(MAX_WAVES_SOUGHT, int(pairs / MIN_PAIRS_PER_WAVE / turns))
    first = max(2, int(MIN_SPAN_WAVES / span) + 1)
    once = [1] if span > MIN_SPAN_ONE_WAVE and pairs >= MIN_PAIRS_PER_WAVE else []
    return [*once, *range(first, last + 1, max(1, round(WAVES_STEP / span)))]


def every_wave(model: JointErrorModel, j: int, about: tuple[Wave, ...]) -> Iterator[Fault]:
    """Waves of every whole number a turn that a joint (from 0) may show."""
    q = model.comparison.q[:, j]
    span = float(np.ptp(q))
    first = max(2, int(MIN_SPAN_ANY_WAVE / span) + 1)
    last = min(MAX_WAVES, int(len(q) / MIN_PAIRS_ANY_WAVE * 2 * np.pi / span))
    yield from waves_of(model, j, range(first, last + 1), about)


def waves_of(
    model: JointErrorModel, j: int, numbers: Sequence[int], about: tuple[Wave, ...] = ()
) -> Iterator[Fault]:
    """A joint's waves (from 0) of given numbers a turn, by its angle without those `about`."""
    q = _true_angle(model.comparison.q[:, [j]], about)
    angles = q * np.array(numbers, dtype=float)
    shapes = np.stack([np.cos(angles), np.sin(angles)], axis=2).reshape(len(q), -1)
    columns = shape_columns(model, j, shapes)
    for i, waves in enumerate(numbers):
        own = slice(2 * i, 2 * i + 2)
        yield Fault(
            "eccentricity", j + 1, "deg", columns[:, own], per_turn=waves, about=about,
            shape=shapes[:, own],
        )  # fmt: skip


def _true_angle(q: Array, about: tuple[Wave, ...]) -> Array:
    """Angles (n, 1) of readings: a wave of n a turn by the reading shows one of 2 n beside."""
    largest = sorted(about, key=lambda wave: -np.hypot(*wave[1:]))
    slopes = np.cumsum([n * np.hypot(a, b) for n, a, b in largest])
    known = largest[: int(np.sum(slopes < MAX_WAVE_SLOPE))]
    true = q
    for _ in range(MAX_STEPS_ANGLE if known else 0):
        true = q - sum(a * np.cos(n * true) + b * np.sin(n * true) for n, a, b in known)
    return true


def shape_columns(model: JointErrorModel, j: int, shape: Array) -> Array:
    """Whitened columns (r, p) of a joint's error that varies as `shape` (n, p) does.

    Of its mean, the registration hides what it hides of an offset; what varies about it is seen.
    """
    mean = shape.mean(axis=0)
    varying = model.joints[:, [j]] * (shape - mean)[model.white.pair]
    columns: Array = varying + model.offsets[:, [j]] * mean
    return columns


def common_faults(model: JointErrorModel, rig: Rig | None) -> list[Fault]:
    """Every common fault, those included that this session cannot show: their columns are 0."""
    comparison = model.comparison
    short = -clock_effect(comparison, steady=True)  # of an offset that wants a second more
    elapsed = comparison.elapsed[:, None, None]
    moved = -base_motion(comparison.base_T_jacobian)
    columns: list[tuple[str, str, Array]] = [
        *([("clock_drift", "ppm", short * elapsed)] if comparison.timed else []),
        ("base_moved", "mm", moved),
        ("base_drift", "mm", moved * comparison.share[:, None, None]),
        ("led_body_slipped", "mm", -body_motion(comparison.base_T_jacobian)),
    ]
    if not model.seen.clock.shape[1]:  # else the offset was fitted, and there is none to correct
        columns.append(("clock", "s", short))
    if rig is not None:
        columns.append(("camera_skew", "s", skew_effect(model, rig)))
    found = [Fault(kind, None, unit, model.white.rows(c)) for kind, unit, c in columns]
    turns = camera_turns(comparison).items()
    found += [Fault(k, None, "deg", model.white.rows(c), variant=v) for (k, v), (c, _) in turns]
    return found


def camera_turns(comparison: Comparison) -> dict[Turn, tuple[Array, Array]]:
    """What turns of the right camera against the left do to xi, (n, 6, p); the angles, (n, p).

    Of an even variant the right camera turns, of an odd one the left; of those from 2 on unevenly,
    by what has gathered at KNOTS instants.
    """
    share, knots = comparison.share[:, None], np.arange(1, KNOTS + 1)
    hats = np.maximum(1 - np.abs(KNOTS * share - knots), 0.0)
    angles = {("camera_turned", 0): np.ones_like(share)}
    angles |= {("camera_drift", k): (share, share, hats, hats)[k] for k in range(4)}
    by_camera = comparison.systematic[:, :, [-1, -2]] * [-1.0, 1.0]
    return {turn: (by_camera[:, :, [turn[1] % 2]] * a[:, None], a) for turn, a in angles.items()}


def skew_effect(model: JointErrorModel, rig: Rig) -> Array:
    """What a second by which the right picture is later than stamped does to xi, (n, 6, 1).

    Half of it is a common delay of both pictures; the other half turns the right camera's rays on
    and the left one's back, by the angle that the LEDs pass in it, and shows as depth. How the
    rays cross above and below is left out: it shows in the residuals of the spots, not in the pose.
    """
    comparison = model.comparison
    speed = np.einsum("nij,nj->ni", comparison.jacobian, comparison.rate)[:, :3]
    rig_R_base = rig.rig_T_base[:3, :3]
    place = comparison.base_T_jacobian[:, :3, 3] @ rig_R_base.T + rig.rig_T_base[:3, 3]
    velocity = speed @ rig_R_base.T
    apart = np.zeros((len(comparison), 6))
    for camera, column, sign in ((rig.left, -2, -0.5), (rig.right, -1, 0.5)):
        arm = place - camera.pan_center
        arm = arm - np.outer(arm @ camera.pan_axis, camera.pan_axis)
        turning = np.cross(arm, velocity) @ camera.pan_axis / np.sum(arm**2, axis=1)
        apart += sign * turning[:, None] * comparison.systematic[:, :, column]
    if not apart.any():  # no cameras, or nothing moves across them
        return np.zeros((len(comparison), 6, 1))
    return apart[:, :, None] + clock_effect(comparison, steady=True) / 2
