"""Have everything that numba compiles compiled, so that no first run waits for it.

python -m verify.compile_ahead     after an installation
"""

import numpy as np

from verify.calibration.saddle import Place, fit_corner
from verify.judgement.monte_carlo_poses import Views, camera_draws, refit
from verify.rig import Camera
from verify.warm_up import warm_up, warm_up_comparison

SQUARE = 20.0  # px
SPOTS = 4  # an image


def compile_ahead() -> None:
    """Compile what watching a robot takes, and what a first report and calibration would."""
    warm_up()
    warm_up_comparison()
    _refit()
    _fit_corner()


def _refit() -> None:
    """One drawn world of one pair, in which nothing moved."""
    still = Camera(np.eye(3), np.zeros(5), np.zeros(3), np.array([0.0, 1.0, 0.0]), 0.0, np.eye(4))
    camera = camera_draws(still, "left", {}, np.zeros(1))
    points = np.random.default_rng(0).normal(size=(1, 2 * SPOTS, 3)) + 5.0
    views = Views(camera, camera, SPOTS)
    refit(np.eye(4), points, np.zeros((1, 2 * SPOTS, 2)), views, np.eye(4 * SPOTS))


def _fit_corner() -> None:
    """A picture without a corner."""
    place = Place(np.full(2, 2 * SQUARE), SQUARE * np.eye(2), np.zeros((2, 2)))
    fit_corner(np.zeros((80, 80)), place)


if __name__ == "__main__":
    compile_ahead()
