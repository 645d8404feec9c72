"""Tail probabilities and quantiles of the chi², Student and normal laws, as in scipy.stats.

Taken from scipy.special: importing scipy.stats takes a third of a second, in every process.
"""

from collections.abc import Callable
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy import special

from verify.core.records import Array

MAD_TO_SIGMA = 1.4826  # standard deviation of a normal law over its median absolute deviation

_special: Any = special  # its type stubs accept no general arrays
_Ufunc = Callable[..., Array]
_chdtri: _Ufunc = _special.chdtri
_chdtrc: _Ufunc = _special.chdtrc
_fdtrc: _Ufunc = _special.fdtrc
_gammaincinv: _Ufunc = _special.gammaincinv
_stdtrit: _Ufunc = _special.stdtrit
norm_ppf: _Ufunc = _special.ndtri  # value that a standard normal variable is below, by chance
norm_cdf: _Ufunc = _special.ndtr  # probability that a standard normal variable is below a value


def correlation(covariance: Array) -> Array:
    """Correlations (n, n) of a covariance; NaN where a variance is 0 or not known."""
    sigma = np.sqrt(np.diag(covariance))
    with np.errstate(invalid="ignore", divide="ignore"):
        found: Array = covariance / np.outer(sigma, sigma)
    return found


def chi2_isf(share: ArrayLike, degrees: ArrayLike) -> Array:
    """Value that a chi² variable exceeds with a given probability."""
    return _chdtri(degrees, share)


@lru_cache(maxsize=1024)
def chi2_bound(share: float, degrees: int) -> float:
    """`chi2_isf` of one value, kept: a measured pair needs the same few."""
    return float(chi2_isf(share, degrees))


def chi2_sf(value: ArrayLike, degrees: ArrayLike) -> Array:
    """Probability that a chi² variable exceeds a value."""
    return _chdtrc(degrees, value)


def chi2_ppf(share: ArrayLike, degrees: ArrayLike) -> Array:
    """Value that a chi² variable stays below with a given probability."""
    return 2.0 * _gammaincinv(np.asarray(degrees) / 2, share)


def f_sf(value: ArrayLike, degrees: ArrayLike, below: ArrayLike) -> Array:
    """Probability that an F variable exceeds a value; `below`: degrees of its denominator."""
    return _fdtrc(degrees, below, value)


def t_ppf(share: ArrayLike, degrees: ArrayLike) -> Array:
    """Value that Student's t stays below with a given probability; degrees may be infinite."""
    return _stdtrit(degrees, share)


def t_isf(share: ArrayLike, degrees: ArrayLike) -> Array:
    """Value that Student's t exceeds with a given probability; degrees may be infinite."""
    return -t_ppf(share, degrees)


def norm_isf(share: ArrayLike) -> Array:
    """Value that a standard normal variable exceeds with a given probability."""
    return -norm_ppf(share)
