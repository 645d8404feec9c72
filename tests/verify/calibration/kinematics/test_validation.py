"""Which model a hold-out chooses."""

import numpy as np
import pytest

from verify.calibration.kinematics.validation import CrossValidation, best_model

# Of ten blocks, 6 standard errors; of five, 1.2.
GAIN = np.array([0.9, 1.3, 0.2, 1.5, 0.4, 1.1, 0.3, 1.2, 0.8, 1.3])
LUCKY = np.array([0.1, 0.1, -0.05, 0.12, -0.04])


def held_out(chi2: np.ndarray, splits: int) -> CrossValidation:
    return CrossValidation(splits, 20, np.zeros(3), np.zeros(3), chi2)


@pytest.mark.parametrize(
    ("gain", "splits", "chosen"), [(GAIN, 10, 1), (GAIN, 1, 1), (LUCKY, 10, 1), (LUCKY, 2, 0)]
)
def test_blocks_of_few_splits_share_their_luck(gain: np.ndarray, splits: int, chosen: int) -> None:
    models = [held_out(np.full(len(gain), 2.0), splits), held_out(2.0 - gain, splits)]
    assert best_model(models, np.arange(len(gain))) == chosen


def test_one_block_does_not_tell_models_apart() -> None:
    models = [held_out(np.full(5, 2.0), 10), held_out(np.full(5, 1.0), 10)]
    assert best_model(models, np.zeros(5, np.int64)) == 0
