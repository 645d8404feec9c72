"""A session as a linear model: what joint errors, a registration and stated doubts move."""

from dataclasses import dataclass, replace

import numpy as np

from verify.clock import ClockEstimate
from verify.comparison import Comparison
from verify.marker import Marker
from verify.records import Array
from verify.regression import Whitener, whiten
from verify.rig import Rig
from verify.systematics import Systematics, root
from verify.track import Track

# More distinct pan readings than this are taken as errors of single pairs, which average out.
MOST_PAN_GROUPS = 60
INVISIBLE = 1e-3  # of a joint's column: a share below this is what rounding leaves of nothing
STEADY = 5.0  # standard deviations of a mean speed that readings at rest do not reach


@dataclass(frozen=True, slots=True)
class Shares:
    """Columns whitened by the measured poses' covariance alone, (r, .) each."""

    joints: Array
    hidden: Array
    fitted: Array
    clock: Array  # (r, 0 or 1), of a clock that was estimated


@dataclass(frozen=True, slots=True)
class Model:
    """Whitened rows (r) of a session with n pairs and an arm of j joints."""

    comparison: Comparison
    white: Whitener
    xi: Array  # (r,)
    joints: Array  # (r, j), of a constant offset that arose after registration, 1 rad
    hidden: Array  # (r, j), the same for one that was there at registration
    fitted: (
        Array  # (r, f), free columns: clock, and base and LED body where this session's stand in
    )
    seen: "Shares"  # the same columns as the pictures alone weigh them
    prior: Array  # (r, p), columns of unit variance: everything stated that does not average out
    prior_columns: Array  # (n, 6, p), the same before whitening
    through_encoders: bool  # base or LEDs were fitted through the robot's own encoders
    clock_open: bool  # the arm moves, but not so that its clock can be told from an offset
    stands_in: bool  # the registration's motion is not known; this session's stands for it

    @property
    def offsets(self) -> Array:
        """The joint columns that a constant error is judged by, (r, j)."""
        return self.hidden if self.through_encoders else self.joints


def build(
    comparison: Comparison,
    track: Track,
    rig: Rig,
    marker: Marker,
    clock: ClockEstimate,
    systematics: Systematics,
) -> Model:
    """Lay a comparison out as a whitened linear model."""
    white = whiten(comparison)
    jacobian = comparison.jacobian
    latency = clock_effect(comparison, steady=clock.source == "not_observable")
    open_clock = clock.source != "given" and bool(latency.any())
    clock_columns = latency if open_clock else latency[:, :, :0]
    held = prior_columns(comparison, track, clock, systematics)
    base, body = rig.base_source == "motion", marker.source == "motion"
    hidden, fitted = jacobian, clock_columns
    if rig.absorption is not None and (base or body):
        full = _registered(comparison, base=True, body=True)
        hidden = jacobian - full @ _in_base_axes(rig) @ rig.absorption
    elif base or body:
        registered = _registered(comparison, base=base, body=body)
        fitted = np.concatenate([clock_columns, registered], axis=2)
    hidden = _without_rounding(hidden, jacobian, white)
    # shares are of what the pictures show, whatever the readings' noise
    pictures = whiten(comparison, comparison.covariance_measured)
    return Model(
        comparison=comparison,
        white=white,
        xi=white.rows(comparison.xi[:, :, None])[:, 0],
        joints=white.rows(jacobian),
        hidden=white.rows(hidden),
        fitted=white.rows(fitted),
        seen=Shares(*(pictures.rows(c) for c in (jacobian, hidden, fitted, clock_columns))),
        prior=white.rows(held),
        prior_columns=held,
        through_encoders=base or body,
        clock_open=clock.source == "not_observable" and open_clock,
        stands_in=(base or body) and rig.absorption is None,
    )


def clock_effect(comparison: Comparison, *, steady: bool = False) -> Array:
    """What a second of clock offset does to xi, (n, 6, 1); steady: at the joints' mean speeds.

    A motion that does not show the offset is at rest or of constant speed; what its speeds seem
    to vary is the readings' noise, which must not look like something that tells a clock error
    from an offset.
    """
    rate = comparison.rate
    if steady:
        noise = np.sqrt(comparison.rate_variance)
        mean = rate.mean(axis=0)
        moves = np.abs(mean) > STEADY * noise / np.sqrt(len(rate))
        varies = rate.std(axis=0) > STEADY * noise
        rate = np.where(varies, rate, np.where(moves, mean, 0.0))
    effect: Array = -np.einsum("nij,nj->ni", comparison.jacobian, rate)[:, :, None]
    return effect


def _without_rounding(hidden: Array, jacobian: Array, white: Whitener) -> Array:
    """Zero the columns of joints of which a registration left nothing but rounding."""
    left = np.linalg.norm(white.rows(hidden), axis=0)
    whole = np.linalg.norm(white.rows(jacobian), axis=0)
    return np.where(left > INVISIBLE * whole, hidden, 0.0)


def _registered(comparison: Comparison, *, base: bool, body: bool) -> Array:
    """What a motion of the registered base (base axes) or LED body (flange axes) does to xi."""
    n = len(comparison)
    columns = np.zeros((n, 6, 0))
    flange = comparison.base_T_jacobian
    if base:
        arm = flange[:, :3, 3]
        motion = np.tile(np.eye(6), (n, 1, 1))
        motion[:, :3, 3:] = -_cross(arm)
        columns = np.concatenate([columns, motion], axis=2)
    if body:
        turn = np.zeros((n, 6, 6))
        turn[:, :3, :3] = turn[:, 3:, 3:] = flange[:, :3, :3]
        columns = np.concatenate([columns, turn], axis=2)
    return columns


def _cross(vectors: Array) -> Array:
    """Matrices of v x ., (n, 3, 3)."""
    x, y, z = vectors.T
    zero = np.zeros_like(x)
    matrix = np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=-1)
    return matrix.reshape(-1, 3, 3)


def _in_base_axes(rig: Rig) -> Array:
    """Carry (base motion in rig axes, body motion in flange axes) to base axes, (12, 12)."""
    base_R_rig = rig.rig_T_base[:3, :3].T
    carried = np.eye(12)
    carried[:3, :3] = carried[3:6, 3:6] = base_R_rig
    return carried


def prior_columns(
    comparison: Comparison, track: Track, clock: ClockEstimate, systematics: Systematics
) -> Array:
    """Columns of unit variance for everything stated that does not average out, (n, 6, p)."""
    count = len(systematics.names)
    columns = [comparison.systematic[:, :, :count] @ root(systematics.covariance)]
    if clock.source == "given" and clock.standard_uncertainty:
        columns.append(clock_effect(comparison) * clock.standard_uncertainty)
    if comparison.alignment_error.any():
        columns.append(comparison.alignment_error[:, :, None])
    columns.extend(pan_columns(comparison, track, systematics, side) for side in (0, 1))
    return np.concatenate(columns, axis=2)


def pan_columns(comparison: Comparison, track: Track, systematics: Systematics, side: int) -> Array:
    """One column a distinct pan reading of a camera: pairs that share it share its error."""
    sigma, n = systematics.pan[side], len(comparison)
    if not sigma > 0:
        return np.zeros((n, 6, 0))
    distinct, group = np.unique(track.pan[comparison.index, side], return_inverse=True)
    if len(distinct) > MOST_PAN_GROUPS:
        return np.zeros((n, 6, 0))
    effect = comparison.systematic[:, :, len(systematics.names) + side] * sigma
    chosen = group[:, None] == np.arange(len(distinct))
    columns: Array = effect[:, :, None] * chosen[:, None, :]
    return columns


def with_pan_noise(comparison: Comparison, track: Track, systematics: Systematics) -> Comparison:
    """Count the errors of many distinct pan readings with what varies from pair to pair."""
    covariance = comparison.covariance
    for side in (0, 1):
        distinct = len(np.unique(track.pan[comparison.index, side]))
        if systematics.pan[side] > 0 and distinct > MOST_PAN_GROUPS:
            effect = comparison.systematic[:, :, len(systematics.names) + side]
            effect = effect * systematics.pan[side]
            covariance = covariance + effect[:, :, None] * effect[:, None, :]
    return replace(comparison, covariance=covariance)
