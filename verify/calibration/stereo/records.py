"""The result of a calibration from boards, and the rig's covariance as rig.toml states it."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from verify.core.fiducials import Board
from verify.core.records import Array, Flags, Index
from verify.core.rig import Covariance, Rig
from verify.measurement.systematics import covariance_in_si, unit


@dataclass(frozen=True, slots=True)
class Residuals:
    """Every corner that entered the adjustment, one row each."""

    camera: Index  # (r,), 0 left, 1 right
    frame: Index  # (r,)
    corner: Index  # (r,), index into board.points
    observed: Array  # (r, 2), px
    residual: Array  # (r, 2), px, observed less predicted
    uncertainty: Array  # (r,), px a coordinate: as the corner finder states it, times `noise`
    used: Flags  # (r,), false: refused as an outlier


@dataclass(frozen=True, slots=True)
class Calibration:
    """Two cameras, and the boards that they were calibrated with."""

    rig: Rig  # cameras and [covariance]; not registered: no robot base
    board: Board
    frames: Index  # (b,), pairs that were used
    rig_T_board: Array  # (b, 4, 4)
    board_covariance: Array  # (b, 6, 6), m and rad, perturbation on the left, rig axes
    residuals: Residuals
    noise: float  # factor on the corners' stated uncertainty
    degrees_of_freedom: int
    fixed: tuple[str, ...]  # parameters that the choice of the rig frame fixes
    decisions: tuple[str, ...]  # sentences: the model chosen and why, pairs left out and why
    square_found: tuple[float, float, float]  # m: mean triangulated edge, its standard
    # uncertainty, standard deviation of single edges
    turning: bool  # the bases were turned between pairs
    motion: Array | None = None  # (b, 3), m, rig axes, of boards from left to right; None: none


def rms(residual: Array) -> float:
    """Root mean square length of residuals (n, 2), px; NaN where there are none."""
    return float(np.sqrt(np.mean(np.sum(residual**2, axis=1)))) if len(residual) else float("nan")


def camera_covariance(rig: Rig) -> tuple[tuple[str, ...], Array]:
    """Names (p) and covariance (p, p), SI units and pixels, of the cameras' stated parameters.

    Raises:
        ValueError: the rig states no covariance.
    """
    given = rig.covariance
    if given is None:
        raise ValueError("the rig states no covariance")
    own = [i for i, name in enumerate(given.parameters) if name.startswith(("left.", "right."))]
    return tuple(given.parameters[i] for i in own), covariance_in_si(given)[np.ix_(own, own)]


def state_covariance(
    names: Sequence[str],
    full: Array,
    degrees_of_freedom: float | None = None,
    temperature_c: float | None = None,
) -> Covariance:
    """State a covariance (p, p) in SI units and pixels, which may be singular, as rig.toml does.

    The p names are as in rig.toml, the suffix is the unit; the temperature is the rig's during
    calibration.
    """
    sigma = np.sqrt(np.diag(full))
    safe = np.where(sigma > 0, sigma, 1.0)
    correlation = full / np.outer(safe, safe)
    np.fill_diagonal(correlation, 1.0)
    return Covariance(
        parameters=tuple(names),
        standard_uncertainty=sigma / np.array([unit(n) for n in names]),
        correlation=(correlation + correlation.T) / 2,
        degrees_of_freedom=degrees_of_freedom,
        temperature_c=temperature_c,
    )


def extend_covariance(
    given: Covariance | None, names: Sequence[str], by_given: Array, own: Array
) -> Covariance:
    """Add parameters that were found through those already stated, with their correlation.

    A base found through a rig shares the rig's errors, which cancel in part when the rig measures
    again. `by_given` (m, p) is d new / d given, `own` (m, m) the covariance from the new ones' own
    data, SI units and pixels; the m names are as in rig.toml.
    """
    if given is None:
        return state_covariance(names, own)
    base = covariance_in_si(given)
    across = by_given @ base
    full = np.block([[base, across.T], [across, across @ by_given.T + own]])
    return state_covariance(
        (*given.parameters, *names), full, given.degrees_of_freedom, given.temperature_c
    )
