"""The rig's covariance, and what a registration adds to it."""

from collections.abc import Sequence

import numpy as np

from verify.records import Array
from verify.rig import Covariance
from verify.systematics import unit


def in_si(covariance: Covariance) -> Array:
    """Full covariance matrix of the named parameters, (p, p), in SI units and pixels."""
    sigma = covariance.standard_uncertainty * np.array([unit(n) for n in covariance.parameters])
    full: Array = covariance.correlation * np.outer(sigma, sigma)
    return full


def stated(
    names: Sequence[str],
    full: Array,
    degrees_of_freedom: float | None = None,
    temperature_c: float | None = None,
) -> Covariance:
    """Lay a covariance matrix in SI units and pixels out as rig.toml states it.

    Args:
        names: (p) parameters, named as in rig.toml; the suffix is the unit.
        full: (p, p), SI units and pixels; may be singular.
        degrees_of_freedom: of the estimate behind it.
        temperature_c: of the rig while it was calibrated.
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


def extend(
    given: Covariance | None, names: Sequence[str], by_given: Array, own: Array
) -> Covariance:
    """Add parameters that were found through those already there.

    A base found through a rig shares the rig's errors: what it is correlated with cancels in part
    when the rig measures again, which only the full matrix shows.

    Args:
        given: what rig.toml states; None: nothing.
        names: (m) new parameters, named as in rig.toml.
        by_given: (m, p), d new / d given, SI units and pixels.
        own: (m, m), what the new ones' own data leave open, SI units.
    """
    if given is None:
        return stated(names, own)
    base = in_si(given)
    across = by_given @ base
    full = np.block([[base, across.T], [across, across @ by_given.T + own]])
    return stated((*given.parameters, *names), full, given.degrees_of_freedom, given.temperature_c)
