"""Compare the encoders' poses with the measured ones, as twists and as joint angles.

All statistics start from the twist xi of the readings' pose less the measured one (translation,
rotation vector; base axes at the flange; m and rad) and the Jacobian J with xi = J e for joint
errors e. No joint angle is inverted for them, so a pair near a singularity does no harm. Joint
angles of measured poses come from the inverse, the branch nearest the readings.
"""

import contextlib
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from scipy.spatial.transform import Rotation

import robots
from robots.transforms import rigid_columns
from verify.core.kernels.entries import rotation_vectors
from verify.core.readings import RATE_SPAN, Readings
from verify.core.records import Array, Flags, Index
from verify.measurement.alignment import MAX_GAP
from verify.measurement.kernels.entries import MOTION_RATE
from verify.measurement.track import Track, difference_weights

MIN_ACCELERATIONS = 5  # differences that make a session's mean square
MAX_GAUGE_STEPS = 12  # Newton on a turn: from half a turn away it takes six
TOL_GAUGE = 1e-9  # rad
NO_WEIGHT = 1e8  # on a covariance: less than what any session could tell
TOL_SINGULAR = 1e-9  # of the largest singular value: what a singularity leaves of one
MAX_PLAIN = 1e4  # product of entries' sizes: no singular value is near TOL_SINGULAR
# A direction that moves a joint less than this share of the most moved one is rounding.
MIN_MOTION = 1e-6
GROSS_ERROR = np.deg2rad(3.0)  # of a joint: first order says it to some per mille
MAX_APART, LEVELS = np.deg2rad(1.0), 2  # of pairs about such an error; before and after a step


@dataclass(frozen=True, slots=True)
class Comparison:
    """n pairs that have both a pose and a reading; arm with j joints."""

    index: Index  # (n,), rows of the track
    t: Array  # (n,), s
    q: Array  # (n, j), rad, readings at the left camera's instant
    rate: Array  # (n, j), rad/s
    direction: Array  # (n, j), last direction of travel
    jacobian: Array  # (n, 6, j), carries joint errors to xi; see `relinearise`
    q_jacobian: Array  # (n, j), rad, where the Jacobian is taken
    base_T_jacobian: Array  # (n, 4, 4), the flange there
    base_T_encoder: Array  # (n, 4, 4), the flange where the readings put it
    base_T_measured: Array  # (n, 4, 4); directions that the LEDs leave open follow the readings
    xi: Array  # (n, 6), readings' pose less measured
    covariance: Array  # (n, 6, 6), of xi from pair to pair: pixels, alignment, readings
    covariance_measured: Array  # (n, 6, 6), of the measured pose alone
    systematic: Array  # (n, 6, p + 2), d xi / d stated parameter, pan readings last
    alignment_error: Array  # (n, 6), what alignment left, as far as the neighbours show it
    tilt: Array  # (n, 6, k), what a camera that was tilted may do to it; see `Track`
    determined: tuple[Array, ...]  # n of (6, d)
    rate_variance: Array  # (j,), (rad/s)², what the readings' noise does to `rate`
    local_noise: Array  # (n, j), rad, standard deviation of a reading about each pair
    timed: bool = True  # False: t only tells the order

    @property
    def elapsed(self) -> Array:
        """Time since the first pair, (n,), s; zeros where no time was noted."""
        elapsed: Array = (self.t - self.t[0]) * self.timed
        return elapsed

    @property
    def share(self) -> Array:
        """What has passed of the time from the first pair to the last, (n,); zeros likewise."""
        return self.elapsed / (self.elapsed[-1] or 1.0)

    def __len__(self) -> int:
        """Count the compared pairs."""
        return len(self.index)

    @property
    def reading_noise(self) -> Array:
        """Standard deviation of one reading, (j,), rad, from what it does to a rate."""
        return np.sqrt(2 * self.rate_variance) * RATE_SPAN


@dataclass(frozen=True, slots=True)
class ReadingUncertainty:
    """What is stated of the readings beside their noise; None: not known."""

    resolution: float | None = None  # rad, the last digit
    time: float | Array | None = None  # s, standard, of time stamps; or of those about a pair (n,)
    interpolation: Array | None = None  # (n, j), rad, standard, of the curve between readings


def compare(
    track: Track,
    arm: robots.Arm,
    readings: Readings,
    offset: float | Array,
    *,
    stated: ReadingUncertainty = ReadingUncertainty(),
    known: Flags | None = None,
) -> Comparison:
    """Set the readings at each pair's instant against its measured pose.

    One row a pair that has a reading, of those that `known` (n,) takes. `offset`, s, is added to
    the readings' time to get the cameras' clock, or is one a pair (n,). Arrays of `stated` have a
    row a pair of the track.
    """
    there = track.t - offset
    if known is None:
        known = readings.available(there)
    index = known.nonzero()[0]
    # all of them without a copy
    some: Index | slice = index if len(index) < len(known) else slice(None)
    there = there[some]
    q, rate = readings.motion(there)
    encoder, jacobian = robots.forward_and_jacobian(arm, q)
    measured, determined, carry = _complete_poses(
        track.base_T_flange[some], encoder, tuple(track.determined[i] for i in index.tolist())
    )
    noise = readings.noise_at(there)
    spread = _reading_covariance(noise, stated, index, jacobian, rate)
    scale = alignment_scale(track)[:, None, None]
    own = (scale * track.covariance_alignment + track.covariance_pixels)[some]
    systematic, missed, tilt = (
        -track.systematic[some],
        -track.alignment_error[some],
        track.tilt[some],
    )
    if carry is not None:
        own, systematic = carry @ own @ np.swapaxes(carry, 1, 2), carry @ systematic
        tilt = carry @ tilt
        missed = (carry @ missed[:, :, None])[:, :, 0]
    return Comparison(
        index=index,
        t=track.t[some],
        q=q,
        rate=rate,
        direction=readings.direction(there),
        jacobian=jacobian,
        q_jacobian=q,
        base_T_jacobian=encoder,
        base_T_encoder=encoder,
        base_T_measured=measured,
        xi=twist_difference(encoder, measured),
        covariance=own + spread,
        covariance_measured=own,
        systematic=systematic,
        alignment_error=missed,
        tilt=tilt,
        determined=determined,
        rate_variance=readings.noise**2 / (2 * RATE_SPAN**2),
        local_noise=noise,
    )


def _reading_covariance(
    noise: Array, stated: ReadingUncertainty, index: Index, jacobian: Array, rate: Array
) -> Array:
    """Covariance of xi by the readings of some pairs of a track, (n, 6, 6)."""
    variance = noise**2
    if stated.interpolation is not None:
        variance = variance + stated.interpolation[index] ** 2
    if stated.resolution is not None:
        variance = variance + stated.resolution**2 / 12
    spread = propagate(jacobian, variance)
    if stated.time is not None:
        moved = jacobian @ rate[:, :, None]
        if isinstance(stated.time, np.ndarray):
            moved *= stated.time[index, None, None]
        else:
            moved *= stated.time
        spread += moved @ moved.swapaxes(1, 2)
    return spread


def propagate(jacobian: Array, variance: Array) -> Array:
    """Covariance (n, 6, 6) of xi by independent joints of such variances, (n, j) or (1, j)."""
    return np.asarray((jacobian * variance[:, None]) @ jacobian.swapaxes(1, 2))


def relinearise(comparison: Comparison, arm: robots.Arm, error: Array, gross: Array) -> Comparison:
    """Take the Jacobian halfway between readings and truth, for such errors, (j,) or (n, j).

    There the first order is exact to the third: a joint that is 3° off accuses no neighbour. Of
    what joints are grossly off by, `gross` (n, j), it is taken at the truth, and xi is what J
    makes of that beside the rest.
    """
    middle = comparison.q - (error + gross) / 2
    flange, jacobian = robots.forward_and_jacobian(arm, middle)
    xi = comparison.xi
    if gross.any():
        rest = robots.forward(arm, comparison.q - gross)
        xi = twist_difference(rest, comparison.base_T_measured)
        xi = xi + (jacobian @ gross[:, :, None])[:, :, 0]
    noise = comparison.local_noise**2  # lies along the Jacobian, too
    moved = propagate(jacobian, noise) - propagate(comparison.jacobian, noise)
    return replace(
        comparison,
        jacobian=jacobian,
        q_jacobian=middle,
        base_T_jacobian=flange,
        xi=xi,
        covariance=comparison.covariance + moved,
    )


def flange_error(comparison: Comparison, arm: robots.Arm, error: Array) -> Array:
    """Carry joint errors (n, j) to the flange: readings' pose less the true one, (n, 6), m and rad.

    By the Jacobian, but of gross errors by the poses themselves.
    """
    twist: Array = np.einsum("nij,nj->ni", comparison.jacobian, error)
    gross = (np.abs(error) > GROSS_ERROR).any(axis=1)
    if gross.any():
        q = comparison.q[gross]
        true = robots.forward(arm, q - error[gross])
        twist[gross] = twist_difference(robots.forward(arm, q), true)
    return twist


def inflate_covariance(comparison: Comparison, factors: Array) -> Comparison:
    """Let pairs that repeat each other's errors count for fewer.

    `factors` (6,): by which the variance of a mean grows in each whitened direction.
    """
    covariance = comparison.covariance.copy()
    for i, known in enumerate(comparison.determined):
        if known.shape[1] == 6:
            lower = np.linalg.cholesky(covariance[i])
            covariance[i] = (lower * factors) @ lower.T
        else:
            covariance[i] *= factors.max()
    return replace(comparison, covariance=covariance)


def without_weight(comparison: Comparison, pairs: Index) -> Comparison:
    """Let some pairs count for nothing, and keep them."""
    covariance = comparison.covariance.copy()
    covariance[pairs] *= NO_WEIGHT
    return replace(comparison, covariance=covariance)


def twist_difference(a_T_one: Array, a_T_other: Array) -> Array:
    """One pose less the other as a twist in a's axes: (n, 4, 4) twice to (n, 6), m and rad."""
    turn = a_T_one[:, :3, :3] @ a_T_other[:, :3, :3].swapaxes(1, 2)
    rotation = np.empty((len(turn), 3))
    rotation_vectors(turn, rotation)
    return np.concatenate([a_T_one[:, :3, 3] - a_T_other[:, :3, 3], rotation], axis=1)


def _complete_poses(
    measured: Array, encoder: Array, determined: tuple[Array, ...]
) -> tuple[Array, tuple[Array, ...], Array | None]:
    """Move measured poses along what their LEDs leave open to where the readings are nearest.

    A gauge, not a value: the LEDs that were seen stay where they are. The flange's origin moves
    about them, and with it the point that twists refer to. Returns the poses, what is determined
    there (functionals of twists at the new origin), and the matrices (n, 6, 6) that carry twists
    from the old origin to the new one; None where all poses are determined and stay.
    """
    if all(functionals.shape[1] == 6 for functionals in determined):
        return measured, determined, None
    filled, known = measured.copy(), list(determined)
    carry = np.empty((len(measured), 6, 6))
    carry[:] = np.eye(6)
    for i, functionals in enumerate(determined):
        if functionals.shape[1] == 6:
            continue
        for _ in range(MAX_GAUGE_STEPS):
            hidden = np.linalg.svd(known[i], full_matrices=True)[0][:, known[i].shape[1] :]
            xi = twist_difference(encoder[i : i + 1], filled[i : i + 1])[0]
            step = hidden @ np.linalg.lstsq(hidden[3:], xi[3:], rcond=None)[0]
            _apply_screw(filled[i], step)
            carry[i] = twist_transport(filled[i, :3, 3] - measured[i, :3, 3])
            known[i] = np.linalg.inv(carry[i]).T @ functionals
            if np.linalg.norm(step[3:]) < TOL_GAUGE:
                break
    return filled, tuple(known), carry


def _apply_screw(pose: Array, step: Array) -> None:
    """Turn a pose, in place, by a screw without pitch about the axis that the step defines."""
    angle = float(np.linalg.norm(step[3:]))
    if angle == 0.0:
        return
    turn = Rotation.from_rotvec(step[3:]).as_matrix()
    # of a pure turn: velocity at the origin = axis x (origin - a point of the axis)
    arm = np.cross(step[:3], step[3:]) / angle**2  # origin less the axis' nearest point
    pose[:3, :3] = turn @ pose[:3, :3]
    pose[:3, 3] += (turn - np.eye(3)) @ arm


def twist_transport(shift: Array) -> Array:
    """Carry twists to an origin that lies `shift` (..., 3), m, further on, (..., 6, 6)."""
    carry = np.broadcast_to(np.eye(6), (*shift.shape[:-1], 6, 6)).copy()
    carry[..., :3, :] = rigid_columns(shift)  # rho + phi x shift
    return carry


def base_motion(base_T_flange: Array) -> Array:
    """Twist (n, 6, 6) of the flange for a motion of what it stands on, base axes."""
    return twist_transport(base_T_flange[:, :3, 3])


def body_motion(base_T_flange: Array) -> Array:
    """Twist (n, 6, 6) of the flange for a motion of itself in its own axes."""
    motion = np.zeros((len(base_T_flange), 6, 6))
    motion[:, :3, :3] = motion[:, 3:, 3:] = base_T_flange[:, :3, :3]
    return motion


def placement_columns(base_T_flange: Array) -> Array:
    """Twist (n, 6, 12) of the flange for both."""
    return np.concatenate([base_motion(base_T_flange), body_motion(base_T_flange)], axis=2)


def gross_errors(error: Array) -> Array:
    """What joints are off by where first order does not say it well, (n, j); elsewhere 0.

    `error` (n, j), rad; nan where not known. Taken are levels at which a joint stays: of most
    pairs, and of most of the others. What changes from pair to pair is no error of a reading.
    """
    gross = np.zeros(error.shape)
    for j, own in enumerate(error.T):
        left = ~np.isnan(own)
        for _ in range(LEVELS):
            if not left.any():
                break
            level = np.median(own[left])
            near = left & (np.abs(own - level) < MAX_APART)
            if 2 * near.sum() < left.sum():
                break
            gross[near, j] = level if abs(level) > GROSS_ERROR else 0.0
            left &= ~near
    return gross


@lru_cache(maxsize=4)  # a search for the clock's offset asks for the same tracks
def alignment_scale(track: Track) -> Array:
    """How far the session's real motion exceeds (or falls short of) what poses assumed, (n,).

    Second to fourth differences of the measured poses show acceleration, jerk and snap; their mean
    squares over the session, with the poses' own noise taken off, replace what each pair assumed
    from its speed: an arm accelerates most where it turns back and has none. Without enough
    neighbouring pairs the assumption stands.
    """
    scale = np.ones(len(track))
    enough = len(track) >= MIN_ACCELERATIONS + 2 and track.covariance_alignment.any()
    for order in np.unique(track.order).tolist() if enough else ():
        square, chosen = _mean_square_motion(track, order), track.order == order
        if square is not None:
            assumed = np.square(MOTION_RATE ** (order - 2) * track.acceleration_prior[chosen])
            scale[chosen] = np.mean(square / assumed, axis=1)
    scale.flags.writeable = False  # it is kept
    return scale


def _mean_square_motion(track: Track, order: int) -> Array | None:
    """Mean square of a derivative of the poses, (2,), m²/s^2k, rad²/s^2k; None without enough."""
    if len(track) < MIN_ACCELERATIONS + order:
        return None
    windows = np.lib.stride_tricks.sliding_window_view(np.arange(len(track)), order + 1)
    regular = (np.diff(track.t[windows], axis=1) < MAX_GAP).all(axis=1)
    windows = windows[regular & (track.known_dof[windows] == 6).all(axis=1)]
    if len(windows) < MIN_ACCELERATIONS:
        return None
    weights = difference_weights(track.t[windows])
    poses, middle = track.base_T_flange[windows], track.base_T_flange[windows[:, order // 2]]
    moved = [twist_difference(poses[:, k], middle) for k in range(order + 1)]
    motion = np.einsum("wk,kwi->wi", weights, np.array(moved))
    own = np.diagonal(track.covariance_pixels, axis1=1, axis2=2)[windows]
    noise = np.einsum("wk,wki->wi", weights**2, own)
    square = np.maximum(np.mean(motion**2 - noise, axis=0), 0.0)  # of each component
    return np.array([square[:3].mean(), square[3:].mean()])


@dataclass(frozen=True, slots=True)
class JointComparison:
    """n pairs, j joints. Angles in rad, the robot file's own."""

    q: Array  # (n, j), measured; nan where the LEDs or a self-motion leave a joint open
    error: Array  # (n, j), readings less measured
    covariance: Array  # (n, j, j), of the error, from pair to pair
    inverse: Array  # (n, j, 6), d q / d pose
    reached: Flags  # (n,), the arm can stand in the measured pose
    coupling: tuple[robots.Coupling | None, ...]  # joints that a singularity near by couples

    @property
    def coupled(self) -> Flags:
        """Joints that a singularity near by couples, (n, j)."""
        coupled = np.zeros(self.error.shape, dtype=bool)
        for i, coupling in enumerate(self.coupling):
            if coupling is not None:
                coupled[i, list(coupling.joints)] = True
        return coupled

    @property
    def single(self) -> Array:
        """Errors that may enter a single joint's statistics: coupled ones are nan; (n, j)."""
        return np.where(self.coupled, np.nan, self.error) if any(self.coupling) else self.error


def solve_joints(comparison: Comparison, arm: robots.Arm) -> JointComparison:
    """Find the joint angles of every measured pose, and how well each is known."""
    q, reached = robots.nearest(arm, comparison.base_T_measured, comparison.q)
    there = robots.jacobian(arm, q)
    jacobian = np.where(reached[:, None, None], there, comparison.jacobian)
    inverse = pseudo_inverse(jacobian)
    for i, determined in enumerate(comparison.determined):
        if determined.shape[1] < 6 or arm.dof > 6:
            q[i, _undetermined_joints(inverse[i], jacobian[i], determined)] = np.nan
    error = comparison.q - q
    couplings = robots.couplings(arm, comparison.q, comparison.base_T_encoder)
    return JointComparison(
        q=q,
        error=np.arctan2(np.sin(error), np.cos(error)),
        covariance=inverse @ comparison.covariance @ inverse.swapaxes(1, 2),
        inverse=inverse,
        reached=reached,
        coupling=tuple(
            found if there else None
            for found, there in zip(couplings, reached.tolist(), strict=True)
        ),
    )


def pseudo_inverse(jacobian: Array) -> Array:
    """Carry twists to joints, (..., j, 6), by Jacobians (..., 6, j); a singularity is not fatal.

    Far from one the plain inverse is the same to rounding, and takes a fifth of the time.
    """
    if jacobian.shape[-1] == 6:
        with contextlib.suppress(np.linalg.LinAlgError):
            inverse = np.asarray(np.linalg.inv(jacobian), dtype=np.float64)
            if np.abs(inverse).max(initial=0.0) * np.abs(jacobian).max(initial=0.0) < MAX_PLAIN:
                return inverse
    return np.asarray(np.linalg.pinv(jacobian, rcond=TOL_SINGULAR), dtype=np.float64)


def _undetermined_joints(inverse: Array, jacobian: Array, determined: Array) -> Flags:
    """Joints that the undetermined directions, or the arm's self-motion, move; (j,)."""
    dof = jacobian.shape[1]
    moved = np.zeros(dof)
    if determined.shape[1] < 6:
        hidden = np.linalg.svd(determined, full_matrices=True)[0][:, determined.shape[1] :]
        moved += np.linalg.norm(inverse @ hidden, axis=1)
    if dof > 6:
        _, _, right = np.linalg.svd(jacobian, full_matrices=True)
        moved += np.linalg.norm(right[6:], axis=0)
    largest = float(moved.max())
    return moved > MIN_MOTION * largest if largest > 0 else np.zeros(dof, dtype=bool)
