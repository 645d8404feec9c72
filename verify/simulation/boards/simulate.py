"""Board pictures with known truth: a rig on turning bases looks at a chessboard."""

from dataclasses import dataclass

import numpy as np

from verify.core.fiducials import Board
from verify.core.records import Array, Image, rigid_transform
from verify.core.rig import Rig
from verify.errors import InputError
from verify.io.fiducials import BoardTable, build_board
from verify.simulation.boards.render import PrintedBoard
from verify.simulation.scenario import BoardScenario
from verify.simulation.world.bench import (
    SimulatedCamera,
    build_cameras,
    inside,
    rigid,
    rigid_from_table,
    transform,
)
from verify.simulation.world.motion import RandomStream, generator
from verify.simulation.world.uncertainty import stated_cameras

MIN_BORDER_PX = 10.0  # from the pattern's rim to the picture's
MAX_ATTEMPTS = 40  # places for one setting of the bases and distance before both are drawn again
MAX_SETTINGS = 60  # of these
MAX_AZIMUTH = np.radians(28.0)  # within the view of any usual lens; what is outside is drawn again
MAX_ELEVATION = np.radians(16.0)


@dataclass(frozen=True, slots=True)
class SimulatedBoards:
    """What was set up: cameras, how the bases stood, where the board was."""

    scenario: BoardScenario
    board: Board
    cameras: tuple[SimulatedCamera, SimulatedCamera]  # left, right
    pan: Array  # (pairs, 2), rad, as read
    true_pan: Array  # (pairs, 2), rad
    rig_T_board: Array  # (pairs, 4, 4)
    rig_T_base: Array | None  # (4, 4), where the board stands on a robot

    def __len__(self) -> int:
        """Count the pairs."""
        return len(self.pan)

    @property
    def rig(self) -> Rig:
        """The true rig, as rig.toml would describe it."""
        pan_deg = self.scenario.bases.standard_uncertainty_deg
        return Rig(
            self.scenario.rig.image_size,
            *stated_cameras(self.cameras, self.pan[0], pan_deg),
            np.full((4, 4), np.nan) if self.rig_T_base is None else self.rig_T_base,
            base_source="" if self.rig_T_base is None else "fixture",
        )

    def image(self, side: int, index: int) -> Image:
        """Take one picture, (h, w)."""
        return self.render(side, index, self.true_pan[index], self.rig_T_board[index])

    def render(self, side: int, number: int, true_pan: Array, rig_T_board: Array) -> Image:
        """Take a picture, (h, w), by how bases (2,), rad, and board stand; `number`: its noise."""
        scenario = self.scenario
        paper = PrintedBoard(self.board, scenario.boards.margin_mm / 1000, scenario.image)
        rng = generator(scenario.seed, RandomStream.PIXELS, side, number)
        return paper.render(self.cameras[side], float(true_pan[side]), rig_T_board, rng)


def simulate_boards(scenario: BoardScenario) -> SimulatedBoards:
    """Set up what the scenario says, boards drawn so that both cameras see them whole.

    Raises:
        InputError: no such place is found; the tables contradict one another.
    """
    table = scenario.boards
    nearest, farthest = table.distance_mm
    if farthest < nearest:
        raise InputError("boards.distance_mm", "ends before it begins", "the nearest comes first")
    cameras = build_cameras(scenario.rig)
    keys = ("inner_corners", "square_mm", "markers", "marker_mm")
    pattern = {key: getattr(table, key) for key in keys}
    board = build_board("boards", BoardTable(format=1, **pattern))  # checked as board.toml's is
    rig_T_base, still = _fixture(scenario)
    drawn = [_draw(scenario, board, cameras, pair, still) for pair in range(table.pairs)]
    pan = np.array([pan for pan, _ in drawn])
    noise = generator(scenario.seed, RandomStream.PAN).standard_normal(pan.shape)
    true_pan = pan + np.radians(scenario.bases.standard_uncertainty_deg) * noise
    poses = np.array([rig_T_board for _, rig_T_board in drawn])
    return SimulatedBoards(scenario, board, cameras, pan, true_pan, poses, rig_T_base)


def _fixture(scenario: BoardScenario) -> tuple[Array | None, Array | None]:
    """Place robot and board for a board that stands still: rig_T_base, rig_T_board."""
    table = scenario.fixture
    if table is None:
        return None, None
    rig_T_base = rigid_from_table(table.base_rotation_deg, table.base_position_mm)
    return rig_T_base, rig_T_base @ rigid_from_table(
        table.board_rotation_deg, table.board_position_mm
    )


def _draw(
    scenario: BoardScenario,
    board: Board,
    cameras: tuple[SimulatedCamera, SimulatedCamera],
    pair: int,
    still: Array | None,
) -> tuple[Array, Array]:
    """Turn the bases and hold the board until both cameras see it whole: pan (2,), rig_T_board."""
    rng = generator(scenario.seed, RandomStream.MOTION, pair)
    nearest, farthest = scenario.boards.distance_mm
    for _ in range(MAX_SETTINGS):
        pan = _pan(scenario, rng)
        distance = rng.uniform(nearest, farthest) / 1000
        for _ in range(MAX_ATTEMPTS if still is None else 1):
            pose = _draw_pose(scenario, board, pan, distance, rng) if still is None else still
            if all(
                _is_in_view(scenario, camera, angle, board, pose)
                for camera, angle in zip(cameras, pan, strict=True)
            ):
                return pan, pose
    raise InputError(
        "boards.distance_mm" if still is None else "fixture",
        "no place shows the whole board to both cameras",
        remedy="Hold it farther away, make it smaller, or turn the bases less.",
    )


def _pan(scenario: BoardScenario, rng: np.random.Generator) -> Array:
    bases = scenario.bases
    steps = int(bases.range_deg / bases.step_deg + 1e-9)  # 1e-9: 20 / 5 is 4 whatever rounding says
    turned = bases.step_deg * rng.integers(-steps, steps + 1, 2)
    return np.asarray(np.radians(np.asarray(bases.middle_deg) + turned))


def _draw_pose(
    scenario: BoardScenario, board: Board, pan: Array, distance: float, rng: np.random.Generator
) -> Array:
    """Hold the board somewhere before the cameras, tilted and a little rolled; rig_T_board."""
    azimuth = pan.mean() + rng.uniform(-MAX_AZIMUTH, MAX_AZIMUTH)
    elevation = rng.uniform(-MAX_ELEVATION, MAX_ELEVATION)
    level = np.cos(elevation)
    forward = np.array([np.sin(azimuth) * level, np.sin(elevation), np.cos(azimuth) * level])
    right = np.cross([0.0, 1.0, 0.0], forward)
    right /= np.linalg.norm(right)
    turn = np.column_stack([right, np.cross(forward, right), forward])
    facing = rigid_transform(turn, distance * forward)
    about = rng.uniform(0, 2 * np.pi)
    tilt = np.radians(scenario.boards.tilt_deg) * np.sqrt(rng.uniform())
    roll = np.radians(scenario.boards.roll_deg) * rng.uniform(-1, 1)
    tilted = rigid(tilt * np.array([np.cos(about), np.sin(about), 0.0]), np.zeros(3))
    rolled = rigid(np.array([0.0, 0.0, roll]), np.zeros(3))
    centred = rigid(np.zeros(3), -board.points.mean(axis=0))
    return facing @ tilted @ rolled @ centred


def _is_in_view(
    scenario: BoardScenario, camera: SimulatedCamera, pan: float, board: Board, rig_T_board: Array
) -> bool:
    """Whether enough of the pattern is in the picture: `in_view` of it, 1 with the rim."""
    share = scenario.boards.in_view
    points = board.points
    if share == 1:
        low, wide, high = -1, board.columns, board.rows
        rim = [[low, low, 0], [wide, low, 0], [wide, high, 0], [low, high, 0]]
        points = board.square * np.array(rim, dtype=float)
    pixels = camera.project(transform(rig_T_board, points), pan)
    return bool(np.mean(inside(pixels, camera.image_size, MIN_BORDER_PX)) >= share)
