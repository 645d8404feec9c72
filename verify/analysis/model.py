"""A session as a whitened linear model, and which joint errors it can show.

    W xi = W J e + W F f + W P p + noise of unit variance,    p ~ N(0, 1)

==========  =====================================================================
columns     meaning
==========  =====================================================================
J e         joint errors e, less what the registration took in of them
F f         what was fitted with them: clock, and base and LEDs from this motion
P p         stated uncertainties that do not average out, in standard deviations
==========  =====================================================================
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from verify.analysis.clock.estimate import ClockEstimate
from verify.analysis.comparison import Comparison, JointComparison, placement_columns
from verify.analysis.least_squares import Whitener, residual_products, whiten
from verify.core.fiducials import Marker
from verify.core.records import Array, Measurement
from verify.core.rig import Rig
from verify.io.session.session import Session
from verify.measurement.systematics import Systematics, covariance_root
from verify.measurement.track import Track

# More distinct pan readings than this are taken as errors of single pairs, which average out.
MAX_PAN_GROUPS = 60
# of a joint's column: a share below this is what rounding leaves of nothing
MIN_VISIBLE_SHARE = 1e-3
MIN_SPEED_SIGMA = 5.0  # standard deviations of a mean speed that readings at rest do not reach
MIN_PAIRS = 10  # fewer say nothing of a session's shares
# False alarm 0.1 % (two-sided, 3.29) and power 80 % (0.84).
DETECTION_SIGMA = 4.13


@dataclass(frozen=True, slots=True)
class SessionComparison:
    """A session's measured poses against its readings, with what is stated of both."""

    session: Session
    track: Track  # the measured poses
    systematics: Systematics  # stated of rig and marker
    clock: ClockEstimate  # of the readings
    comparison: Comparison  # pairs that repeat each other's errors count in full
    joints: JointComparison  # measured angles of the compared pairs
    # one a row of the track, whose spots can be fitted anew; none where the poses are given
    measurements: tuple[Measurement, ...] = ()
    # at the offset that the motion shows, and by what a given one is far from it, s
    at_shown_clock: tuple[Comparison, float] | None = None

    @property
    def clock_uncertainty(self) -> float | None:
        """Standard uncertainty of a clock offset that was estimated, s; None of a given one."""
        return self.clock.standard_uncertainty if self.clock.source == "estimated" else None


@dataclass(frozen=True, slots=True)
class WhitenedColumns:
    """Columns whitened by the measured poses' covariance alone, (r, .) each."""

    joints: Array
    hidden: Array
    fitted: Array
    clock: Array  # (r, 0 or 1), of a clock that was estimated


@dataclass(frozen=True, slots=True)
class JointErrorModel:
    """Whitened rows (r) of a session with n pairs and an arm of j joints."""

    comparison: Comparison
    white: Whitener
    xi: Array  # (r,)
    joints: Array  # (r, j), of a constant offset that arose after registration, 1 rad
    hidden: Array  # (r, j), the same for one that was there at registration
    # (r, f), free columns: clock, and base and LED body where this session's stand in
    fitted: Array
    seen: "WhitenedColumns"  # the same columns as the pictures alone weigh them
    prior: Array  # (r, p), columns of unit variance: everything stated that does not average out
    prior_columns: Array  # (n, 6, p), the same before whitening
    through_encoders: bool  # base or LEDs were fitted through the robot's own encoders
    stands_in: bool  # the registration's motion is not known; this session's stands for it

    @property
    def offsets(self) -> Array:
        """The joint columns that a constant error is judged by, (r, j)."""
        return self.hidden if self.through_encoders else self.joints


ModelBuilder = Callable[[Comparison], JointErrorModel]  # lays a comparison out as a model


def build_model(
    comparison: Comparison,
    track: Track,
    rig: Rig,
    marker: Marker,
    clock: ClockEstimate,
    systematics: Systematics,
) -> JointErrorModel:
    """Lay a comparison out as a whitened linear model."""
    white = whiten(comparison)
    jacobian, flange = comparison.jacobian, comparison.base_T_jacobian
    latency = clock_effect(comparison, steady=clock.source == "none")
    open_clock = clock.source not in ("given", "arrival") and bool(latency.any())
    clock_columns = latency if open_clock else latency[:, :, :0]
    held = prior_columns(comparison, track, clock, systematics)
    base, body = rig.base_source == "motion", marker.source == "motion"
    hidden, fitted = jacobian, clock_columns
    if rig.absorption is not None and (base or body):
        full = placement_columns(flange)
        carried = np.eye(12)  # base motion in rig axes, body motion in flange axes: to base axes
        carried[:3, :3] = carried[3:6, 3:6] = rig.rig_T_base[:3, :3].T
        hidden = jacobian - full @ carried @ rig.absorption
    elif base or body:
        moved = placement_columns(flange)[:, :, np.repeat([base, body], 6)]
        fitted = np.concatenate([clock_columns, moved], axis=2)
    # of some joints a registration leaves nothing but rounding
    left, whole = (np.linalg.norm(white.rows(part), axis=0) for part in (hidden, jacobian))
    hidden = np.where(left > MIN_VISIBLE_SHARE * whole, hidden, 0.0)
    # shares are of what the pictures show, whatever the readings' noise
    pictures = whiten(comparison, comparison.covariance_measured)
    return JointErrorModel(
        comparison=comparison,
        white=white,
        xi=white.rows(comparison.xi[:, :, None])[:, 0],
        joints=white.rows(jacobian),
        hidden=white.rows(hidden),
        fitted=white.rows(fitted),
        seen=WhitenedColumns(
            *(pictures.rows(c) for c in (jacobian, hidden, fitted, clock_columns))
        ),
        prior=white.rows(held),
        prior_columns=held,
        through_encoders=base or body,
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
        moves = np.abs(mean) > MIN_SPEED_SIGMA * noise / np.sqrt(len(rate))
        varies = rate.std(axis=0) > MIN_SPEED_SIGMA * noise
        rate = np.where(varies, rate, np.where(moves, mean, 0.0))
    return -(comparison.jacobian @ rate[:, :, None])


def prior_columns(
    comparison: Comparison, track: Track, clock: ClockEstimate, systematics: Systematics
) -> Array:
    """Columns of unit variance for everything stated that does not average out, (n, 6, p)."""
    count = len(systematics.names)
    columns = [comparison.systematic[:, :, :count] @ covariance_root(systematics.covariance)]
    if clock.source in ("given", "arrival") and clock.standard_uncertainty:
        columns.append(clock_effect(comparison) * clock.standard_uncertainty)
    if comparison.alignment_error.any():
        columns.append(comparison.alignment_error[:, :, None])
    columns.append(comparison.tilt)
    columns.extend(pan_columns(comparison, track, systematics, side) for side in (0, 1))
    return np.concatenate(columns, axis=2)


def pan_columns(comparison: Comparison, track: Track, systematics: Systematics, side: int) -> Array:
    """One column a distinct pan reading of a camera: pairs that share it share its error."""
    sigma, n = systematics.pan[side], len(comparison)
    if not sigma > 0:
        return np.zeros((n, 6, 0))
    distinct, group = np.unique(track.pan[comparison.index, side], return_inverse=True)
    if len(distinct) > MAX_PAN_GROUPS:
        return np.zeros((n, 6, 0))
    effect = comparison.systematic[:, :, len(systematics.names) + side] * sigma
    chosen = group[:, None] == np.arange(len(distinct))
    return np.asarray(effect[:, :, None] * chosen[:, None, :])


def add_pan_noise(comparison: Comparison, track: Track, systematics: Systematics) -> Comparison:
    """Count the errors of many distinct pan readings with what varies from pair to pair."""
    covariance = comparison.covariance
    for side in (0, 1):
        distinct = len(np.unique(track.pan[comparison.index, side]))
        if systematics.pan[side] > 0 and distinct > MAX_PAN_GROUPS:
            effect = comparison.systematic[:, :, len(systematics.names) + side]
            effect = effect * systematics.pan[side]
            covariance = covariance + effect[:, :, None] * effect[:, None, :]
    return replace(comparison, covariance=covariance)


def vector_length(vectors: Array, covariance: Array) -> tuple[Array, Array]:
    """Length (n,) of vectors (n, 3) of covariance (n, 3, 3), and its standard uncertainty (n,).

    nan where a vector is. Along the vector; a vector that is shorter than its uncertainty has no
    direction to speak of, and gets that of the least known one.
    """
    size: Array = np.linalg.norm(vectors, axis=1)
    along = vectors / np.where(size > 0, size, 1.0)[:, None]
    variance = np.einsum("ni,nij,nj->n", along, covariance, along)
    largest = np.linalg.eigvalsh(np.nan_to_num(covariance))[:, -1]
    variance = np.where(size**2 > largest, variance, largest)
    uncertainty: Array = np.sqrt(np.where(np.isnan(size), np.nan, variance))
    return size, uncertainty


@dataclass(frozen=True, slots=True)
class Observability:
    """A joint each; nan where the session determines nothing. Angles in rad."""

    fraction: Array  # (j,), of an offset that was there at registration
    fraction_since: Array  # (j,), of one that arose later
    detectable: Array  # (j,), smallest offset that would be noticed
    separable: Array  # (j,), smallest that would be told from an offset of any other joint


def visibility(model: JointErrorModel) -> Observability:
    """Project out what was fitted, one joint at fault at a time.

    Source: Baarda's internal reliability; shares as docs/results.md defines them.
    """
    seen = model.seen
    nothing = np.full(model.joints.shape[1], np.nan)
    whole = np.linalg.norm(seen.joints, axis=0)
    before = _share(seen.fitted, seen.hidden, whole)
    since = _share(seen.clock, seen.joints, whole)
    gram = residual_products(model.fitted, model.prior, [model.offsets])
    gram[before == 0] = gram[:, before == 0] = 0.0
    left = np.sqrt(np.diag(gram))
    detectable = np.divide(DETECTION_SIGMA, left, out=nothing.copy(), where=left > 0)
    few = len(model.comparison) < MIN_PAIRS
    return Observability(
        fraction=nothing if few else before,
        fraction_since=nothing if few else since,
        detectable=detectable,
        separable=_separability_factor(gram),
    )


def _share(fitted: Array, columns: Array, whole: Array) -> Array:
    left = np.sqrt(np.diag(residual_products(fitted, fitted[:, :0], [columns])))
    share = np.divide(left, whole, out=np.full(len(whole), np.nan), where=whole > 0)
    return np.where(
        share < MIN_VISIBLE_SHARE, 0.0, np.minimum(share, 1.0)
    )  # rounding leaves 1 + 2e-16


def _separability_factor(gram: Array) -> Array:
    """The largest over rivals of what an offset must reach to be told from theirs, (j,).

    `gram` (j, j): products of what everything fitted and stated leaves of the joints' columns.
    """
    joints = len(gram)
    separable = np.full(joints, np.nan)
    for j in range(joints):
        rivals = [k for k in range(joints) if k != j and gram[k, k] > 0]
        left = [gram[j, j] - gram[j, k] ** 2 / gram[k, k] for k in rivals]
        smallest = min(left, default=float(gram[j, j]))
        if smallest > MIN_VISIBLE_SHARE**2 * gram[j, j] > 0:
            separable[j] = DETECTION_SIGMA / np.sqrt(smallest)
    return separable
