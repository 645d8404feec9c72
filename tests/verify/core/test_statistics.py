import numpy as np
from scipy import stats

from verify.core import statistics as ours

DEGREES = np.array([1, 2, 3, 6, 90, 5400])
SHARES = np.array([1e-9, 1e-4, 0.05, 0.5, 0.95, 1 - 1e-6])[:, None]


def test_quantiles_and_tails_are_those_of_the_library_of_laws() -> None:
    value = stats.chi2.isf(SHARES, DEGREES)
    for one, other in [
        (ours.chi2_isf(SHARES, DEGREES), value),
        (ours.chi2_sf(value, DEGREES), stats.chi2.sf(value, DEGREES)),
        (ours.f_sf(value, 3, DEGREES), stats.f.sf(value, 3, DEGREES)),
        (ours.chi2_ppf(SHARES, DEGREES), stats.chi2.ppf(SHARES, DEGREES)),
        (ours.t_ppf(SHARES, DEGREES), stats.t.ppf(SHARES, DEGREES)),
        (ours.t_isf(SHARES, DEGREES), stats.t.isf(SHARES, DEGREES)),
        (ours.norm_ppf(SHARES), stats.norm.ppf(SHARES)),
        (ours.norm_isf(SHARES), stats.norm.isf(SHARES)),
        (ours.norm_cdf(SHARES), stats.norm.cdf(SHARES)),
        (ours.t_ppf(SHARES, np.inf), stats.norm.ppf(SHARES)),
    ]:
        np.testing.assert_allclose(one, other, rtol=1e-12)
