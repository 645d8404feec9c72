"""The test for corners that err together, on least squares with errors that are independent."""

import numpy as np
import pytest

from verify.calibration.stereo.estimate import P_FALSE_CLUSTERING, design_effect


@pytest.mark.parametrize(("pairs", "parameters"), [(20, 12), (10, 30)])
def test_independent_corners_seem_to_err_together_as_often_as_stated(
    pairs: int, parameters: int
) -> None:
    rng, count = np.random.default_rng(0), 4000
    # some pairs determine a parameter far better than others
    rows = rng.normal(size=(pairs, 2 * parameters, parameters))
    rows *= np.exp(rng.normal(size=(pairs, 1, parameters)))
    information = np.einsum("bri,brj->ij", rows, rows)
    rows = rows @ np.linalg.inv(np.linalg.cholesky(information)).T
    share = rows.swapaxes(1, 2) @ rows
    noise = rng.normal(size=(count, pairs, 2 * parameters))
    estimate = np.einsum("bri,nbr->ni", rows, noise)
    pull = np.einsum("bri,nbr->nbi", rows, noise) - np.einsum("bij,nj->nbi", share, estimate)
    found = np.mean([design_effect(share, one)[0] > 1 for one in pull])
    assert 0.5 * P_FALSE_CLUSTERING < found < 1.7 * P_FALSE_CLUSTERING
