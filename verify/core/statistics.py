"""Tails and quantiles of the laws that verdicts rest on, named as scipy.stats names them.

The same values out of scipy.special, which has them element by element: importing scipy.stats takes
a third of a second, in every process of a batch.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy import special

from verify.core.records import Array

Function = Callable[..., Any]  # its stubs know no numbers in general
_chi2_isf: Function = special.chdtri
_chi2_sf: Function = special.chdtrc
_gamma_ppf: Function = special.gammaincinv
_t_ppf: Function = special.stdtrit
_norm_ppf: Function = special.ndtri
_norm_cdf: Function = special.ndtr


def chi2_isf(share: ArrayLike, degrees: ArrayLike) -> Array:
    """Value that a chi² variable exceeds with a given probability."""
    value: Array = _chi2_isf(degrees, share)
    return value


def chi2_sf(value: ArrayLike, degrees: ArrayLike) -> Array:
    """Probability that a chi² variable exceeds a value."""
    share: Array = _chi2_sf(degrees, value)
    return share


def chi2_ppf(share: ArrayLike, degrees: ArrayLike) -> Array:
    """Value below which a chi² variable is with a given probability."""
    value: Array = 2.0 * _gamma_ppf(np.asarray(degrees) / 2, share)
    return value


def t_ppf(share: ArrayLike, degrees: ArrayLike) -> Array:
    """Value below which a variable of Student's law is with a given probability.

    Degrees of freedom may be infinite.
    """
    value: Array = _t_ppf(degrees, share)
    return value


def t_isf(share: ArrayLike, degrees: ArrayLike) -> Array:
    """Value that a variable of Student's law exceeds with a given probability; likewise."""
    return -t_ppf(share, degrees)


def norm_ppf(share: ArrayLike) -> Array:
    """Value below which a standard normal variable is with a given probability."""
    value: Array = _norm_ppf(share)
    return value


def norm_isf(share: ArrayLike) -> Array:
    """Value that a standard normal variable exceeds with a given probability."""
    return -norm_ppf(share)


def norm_cdf(value: ArrayLike) -> Array:
    """Probability that a standard normal variable is below a value."""
    share: Array = _norm_cdf(value)
    return share
