"""A right camera that was turned by half a degree since the calibration is the only cause named."""

import numpy as np
import pytest

from tests.bench.diagnosis.sessions import Injected, judged, watched

TURN = 0.008  # rad; depth is off by two per cent, and the poses by a centimetre


@pytest.mark.parametrize("seed", [1071666644, 2685405794])
def test_a_turned_camera_is_told_with_its_angle_and_nothing_beside_it(seed: int) -> None:
    """The derivative at angle 0 leaves fifty times the noise: steps and moved bases."""
    _, found, resolved = judged(watched(seed), Injected("camera_turned", None, TURN))
    assert [(c.kind, c.fault.begin) for c in found.causes] == [("camera_turned", None)]
    (cause,) = found.causes
    assert abs(cause.value - TURN) < 3 * cause.standard_uncertainty < 0.1 * TURN
    assert found.misfit == 1.0
    assert not resolved.lack_of_fit
    assert np.all(np.abs(resolved.mean) < 4 * resolved.uncertainty.max(axis=0))
