"""Robot-world and hand-eye calibration of noisy poses: A X = Y B, and the clock between A and B.

The closed form (handeye.py) takes the turns of X and Y from the turns alone. Where a target's tilt
is seen badly and its place well, as of a small target seen from the front, the places know more of
the turns than the turns do. Here both have their say, each weighed by its own scatter, which is
found with them.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robots.transforms import difference, invert
from verify.calibration.handeye import solve_robustly
from verify.pose import perturb
from verify.records import Array

WILD = 6.0  # times the median residual: a pose of spots confused
ROUNDS = 50
SETTLED = 1e-3  # of a standard uncertainty: smaller steps are no improvement
EXACT = 1e-9  # m, rad and s, likewise, where the uncertainty itself is rounding
RATE_SPAN = 0.02  # s, either way, of the difference that a pose's velocity is taken from
LONGEST_STEP = 0.05  # s, of the clock a round: poses are not linear over longer times

Poses = Callable[[Array], Array]  # instants (n,), s, to poses (n, 4, 4), m


@dataclass(frozen=True, slots=True)
class FittedLoop:
    """The two unknown places of a closed loop and the clock, with what the poses say of them."""

    x: Array  # (4, 4), body_T_flange
    y: Array  # (4, 4), rig_T_base
    offset: float  # s, added to B's time to get A's; 0 where none was asked for
    residual: Array  # (n, 6), A less Y B X⁻¹: at the body, m and rad, in the axes of A and Y
    good: NDArray[np.bool_]  # (n,), poses that it rests on; the others are wild
    place: float  # m, standard deviation of a pose's place, each coordinate
    turn: float  # rad, likewise of its turn
    # (p, p), of x⁻¹'s place (m) and turn (a small rotation vector applied on the left, rad), y's
    # likewise, 12 in all, and the clock's offset (s) as a 13th where it was fitted; of poses that
    # err independently of each other
    covariance: Array

    @property
    def offset_standard_uncertainty(self) -> float | None:
        """Of the clock's offset, s; None where that was not fitted."""
        return float(np.sqrt(self.covariance[12, 12])) if len(self.covariance) > 12 else None


def fit_hand_eye(a: Array, b: Array) -> FittedLoop:
    """Fit A X = Y B, places and turns weighed by their own scatter.

    Args:
        a: (n, 4, 4), the target as a fixed camera sees it (rig_T_body), m.
        b: (n, 4, 4), the flange as the encoders put it (base_T_flange), at the same instants.

    Returns:
        x (body_T_flange) and y (rig_T_base).

    Raises:
        ValueError: fewer than three poses, or poses that leave x and y open (turns about one
            axis alone, or none) or that were seen in a mirror.

    Source: least squares with two variance components, each found as its weighted squares over the
    degrees of freedom that the fit leaves it (Förstner, "Ein Verfahren zur Schätzung von Varianz-
    und Kovarianzkomponenten", Allgemeine Vermessungs-Nachrichten 86, 1979).
    """
    return _fit(np.zeros(len(a)), a, lambda _: b, None)


def fit_streams(t: Array, a: Array, poses: Poses, offset: float) -> FittedLoop:
    """Fit A X = Y B of two streams whose clocks differ, the offset of the clocks with them.

    Args:
        t: (n,), s, A's clock.
        a: (n, 4, 4), as of `fit_hand_eye`.
        poses: B at instants of B's own clock.
        offset: s, where to begin; `motion_start.clock_candidates` finds one near enough.

    Returns:
        x, y and the offset.

    Raises:
        ValueError: as of `fit_hand_eye`.
    """
    return _fit(t, a, poses, offset)


def _fit(t: Array, a: Array, poses: Poses, begin: float | None) -> FittedLoop:
    offset = 0.0 if begin is None else begin
    b = poses(t - offset)
    z, y, good = _start(a, b)
    taken = np.full(2, 6.0)  # degrees of freedom that the fit took of places and of turns
    for _ in range(ROUNDS):
        residual = difference(a, y @ b @ z)
        square = np.sum(residual[good].reshape(-1, 2, 3) ** 2, axis=(0, 2))
        # exact poses have no scatter to weigh by: rounding stands in for it
        freedom = np.maximum(3 * good.sum() - taken, 1.0)
        scatter = np.sqrt(np.maximum(square / freedom, np.finfo(float).eps ** 2))
        columns = _columns(b, y, z)
        if begin is not None:
            columns = np.concatenate([columns, _by_clock(poses, t - offset, y, z)], axis=2)
        scale = np.repeat(scatter, 3)
        white = (columns[good] / scale[:, None]).reshape(6 * good.sum(), -1)
        wanted = -(residual[good] / scale).reshape(-1)
        step = np.linalg.lstsq(white, wanted, rcond=None)[0]
        covariance = np.linalg.pinv(white.T @ white, hermitian=True)
        leverage = np.sum((white @ covariance) * white, axis=1)
        taken = leverage.reshape(-1, 2, 3).sum(axis=(0, 2))
        z, y = perturb(z, step[:6]), perturb(y, step[6:12])
        if begin is not None:
            offset += float(np.clip(step[12], -LONGEST_STEP, LONGEST_STEP))
            b = poses(t - offset)
        if np.all(np.abs(step) < np.maximum(SETTLED * np.sqrt(np.diag(covariance)), EXACT)):
            break
    place, turn = scatter.tolist()
    residual = difference(a, y @ b @ z)
    return FittedLoop(invert(z), y, offset, residual, good, place, turn, covariance)


def _start(a: Array, b: Array) -> tuple[Array, Array, NDArray[np.bool_]]:
    solved, good = solve_robustly(a, b, WILD)
    if solved.mirrored:
        raise ValueError("the poses of A were seen in a mirror")
    if solved.open:
        raise ValueError("all poses turn about one axis, or do not turn: neither place shows")
    return invert(solved.x), solved.y, good


def _columns(b: Array, y: Array, z: Array) -> Array:
    """How the residuals change with the steps of z = x⁻¹ and y, (n, 6, 12), for small residuals."""
    columns = np.zeros((len(b), 6, 12))
    columns[:, :3, :3] = columns[:, 3:, 3:6] = -y[:3, :3] @ b[:, :3, :3]
    columns[:, :3, 6:9] = columns[:, 3:, 9:] = -np.eye(3)
    lever = (b @ z)[:, :3, 3] @ y[:3, :3].T
    columns[:, :3, 9:] = -np.cross(np.eye(3), lever[:, None]).swapaxes(1, 2)
    return columns


def _by_clock(poses: Poses, t: Array, y: Array, z: Array) -> Array:
    """How the residuals change with the clock's offset, (n, 6, 1): B lies further back."""
    later, earlier = (y @ poses(t + step) @ z for step in (RATE_SPAN, -RATE_SPAN))
    return (difference(later, earlier) / (2 * RATE_SPAN))[:, :, None]
