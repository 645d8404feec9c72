"""A board's corners as a corner finder would hand them over, without pictures."""

import numpy as np

from verify.core.fiducials import BoardPair, BoardView
from verify.core.records import Array
from verify.core.rig import Rig
from verify.simulation.boards.simulate import MIN_BORDER_PX, SimulatedBoards, simulate_boards
from verify.simulation.scenario import BoardScenario
from verify.simulation.world.bench import inside, transform
from verify.simulation.world.motion import RandomStream, generator


def true_corners(boards: SimulatedBoards, side: int) -> Array:
    """Where the inner corners truly are in one camera's pictures, (pairs, corners, 2), px."""
    camera, points = boards.cameras[side], boards.board.points
    stood = zip(boards.rig_T_board, boards.true_pan[:, side], strict=True)
    return np.array([camera.project(transform(pose, points), pan) for pose, pan in stood])


def board_pairs(scenario: BoardScenario) -> tuple[list[BoardPair], Rig]:
    """True corners and noise; each corner's covariance is that of the noise, the rig the true one.

    Raises:
        InputError: as `simulate_boards`.
    """
    boards = simulate_boards(scenario)
    left, right = true_corners(boards, 0), true_corners(boards, 1)
    pairs = [
        BoardPair(i, p, q, _view(scenario, left[i], 0, i), _view(scenario, right[i], 1, i))
        for i, (p, q) in enumerate(boards.pan.tolist())
    ]
    return pairs, boards.rig


def _view(scenario: BoardScenario, corners: Array, side: int, index: int) -> BoardView:
    u = scenario.boards.corner_noise_px
    rng = generator(scenario.seed, RandomStream.PIXELS, side, index)
    noisy = corners + u * rng.standard_normal(corners.shape)
    corner = np.flatnonzero(inside(corners, scenario.rig.image_size, MIN_BORDER_PX))
    return BoardView(corner, noisy[corner], np.tile(u**2 * np.eye(2), (len(corner), 1, 1)))
