"""Random halves of real board pictures against each other, and what chance alone would show.

Each half is calibrated from scratch, z = (a - b) / sqrt(u_a² + u_b²) for each parameter; rms of z
over the halves. All halves are of the same few pictures, so that rms of z scatters however true
the uncertainties are: its range (5 to 95 %) is simulated, with corners that err exactly as stated.
A set fails where its pooled z is beyond that range, or a half is refused and the whole is not.

    python -m tests.bench.halves [COUNT] [SEED] [SET …]
"""

import os
import sys
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from tests.bench import cells
from tests.support.beside import shared
from tests.support.boards.calibrated import departure, departure_covariance
from tests.support.boards.made_views import found_pairs
from verify.calibration.quality.accuracy import parameter_derivatives
from verify.calibration.stereo import bundle, gauge
from verify.calibration.stereo.calibrate import calibrate, stack_corners
from verify.calibration.stereo.estimate import invert
from verify.calibration.stereo.gauge import BASE_FIXED, AdjustmentModel
from verify.calibration.stereo.parameters import PARAMETER_NAMES, BundleState
from verify.calibration.stereo.prior import lens_rows
from verify.calibration.stereo.records import Calibration
from verify.calibration.stereo.start import start_lens
from verify.core.fiducials import Board, BoardPair, BoardView
from verify.core.records import Array
from verify.errors import InputError

COUNT, DRAWS, RANGE = 50, 400, (0.05, 0.95)
LOW, HIGH = 0.8, 1.3  # of rms of z
LENS = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3")
DEPARTURE = (*(f"{side}.{key}" for side in ("left", "right") for key in LENS),
             "x", "y", "z", "rx", "ry", "rz")  # fmt: skip
FAINT = 3.0  # px, stated of pairs that only tell how two cameras stand


@dataclass(frozen=True, slots=True)
class BoardSet:
    """Published pictures of a board: pairs, or of one camera alone."""

    left: str  # pictures, a pattern in ../shared/data
    right: str  # "" of one camera alone
    board: Board
    size: tuple[int, int]  # px

    @property
    def count(self) -> int:
        """Parameters that are compared: both lenses and their relation, or one lens."""
        return len(DEPARTURE if self.right else LENS)

    def pairs(self) -> list[BoardPair]:
        """The pictures, their corners found; None in place of a second camera's."""
        left, right = (sorted(shared("data").glob(p)) if p else [] for p in (self.left, self.right))
        return found_pairs(left, right, self.board)

    def calibrate(self, pairs: Sequence[BoardPair]) -> Calibration:
        """Calibrate from some of the pictures."""
        return calibrate(self.every(pairs), self.board, self.size)

    def every(self, pairs: Sequence[BoardPair]) -> Sequence[BoardPair]:
        """What is calibrated: the pairs, or twins of one camera's pictures."""
        return pairs if self.right else twins(pairs, self.board, self.size)


SETS = {
    "stereo": BoardSet("stereo_checkerboard_opencv/left*.jpg",
                       "stereo_checkerboard_opencv/right*.jpg", Board(9, 6, 0.03), (640, 480)),
    "lifecam": BoardSet("camera_1280x720_photonvision/lifecam*/*.png", "", Board(10, 10, 0.03),
                        (1280, 720)),
    "gloworm": BoardSet("camera_1280x720_photonvision/gloworm*/*.jpg", "", Board(8, 6, 0.0254),
                        (1280, 720)),
    "franka": BoardSet("handeye_franka_visp/data-eye-in-hand/*.png", "", Board(9, 6, 0.0236),
                       (640, 480)),
}  # fmt: skip


def twins(pairs: Sequence[BoardPair], board: Board, size: tuple[int, int]) -> list[BoardPair]:
    """One camera's pictures as either camera's alone, so that its lens is found as if alone.

    Three faint pairs, made with a rough lens, relate the cameras; they weigh nothing otherwise.
    """
    views = [p.left for p in pairs]
    lens = start_lens(dict(enumerate(views)), board, size).matrix
    span, points = float(board.points.max()), board.points - board.points.mean(axis=0)
    stated = np.tile(FAINT**2 * np.eye(2), (len(board), 1, 1))
    sides = [(v, None) for v in views] + [(None, v) for v in views]
    for turn in ([0.3, 0.2, 0.0], [-0.3, 0.2, 0.1], [0.1, -0.4, 0.0]):
        places = [np.array([x, 0, 2 * span * lens[0, 0] / size[1]]) for x in (0, -span / 5)]
        centres = [cv2.projectPoints(points, np.array(turn), t, lens, None)[0] for t in places]
        sides.append(tuple(BoardView(np.arange(len(board)), c[:, 0], stated) for c in centres))
    return [BoardPair(i, 0.0, 0.0, *both) for i, both in enumerate(sides)]


def halves(
    kit: BoardSet, pairs: Sequence[BoardPair], count: int, seed: int
) -> tuple[Array, list[str]]:
    """Differences (m, p) of random halves over their standard uncertainties; refusals."""
    rng, z, refused = np.random.default_rng(seed), [], []
    for _ in range(count):
        mixed = [pairs[i] for i in rng.permutation(len(pairs))]
        split = mixed[: len(mixed) // 2], mixed[len(mixed) // 2 :]
        try:
            one, other = map(kit.calibrate, split)
        except InputError as error:
            refused.append(str(error))
            continue
        u = np.sqrt(np.diag(departure_covariance(one) + departure_covariance(other)))
        z.append((departure(one.rig, other.rig) / u)[: kit.count])
    return np.array(z), refused


def chance(kit: BoardSet, pairs: Sequence[BoardPair]) -> Array:
    """Rms of z (DRAWS, p) over all halves of pictures that err exactly as stated.

    To first order a parameter's error is the sum of what each picture moves it by, drawn from its
    own information; halves differ by these with random signs, as many of either.
    """
    rig, every = (whole := kit.calibrate(pairs)).rig, kit.every(pairs)
    corners = stack_corners(every, kit.board)
    state = BundleState(rig.left, rig.right, whole.rig_T_board, np.zeros((len(every), 8)))
    lens = lens_rows(state, kit.size, whole.noise**2)
    model = AdjustmentModel((BASE_FIXED, BASE_FIXED), lens=lens, bowed=True)
    system = bundle.normal_equations(state, corners, model, np.ones(len(corners)))
    basis = gauge.free_directions(gauge.constraints(state, model, corners.pan[0]))
    slope = parameter_derivatives(lambda other: departure(other, rig), rig, PARAMETER_NAMES)
    gain = slope.T[: kit.count] @ basis[: len(slope)] @ invert(basis.T @ system.total @ basis)
    single = gain @ basis.T @ system.information[: len(pairs)] @ basis @ gain.T
    u = np.sqrt(np.diag(single.sum(axis=0)))
    values, directions = np.linalg.eigh(single / np.outer(u, u))
    roots = directions * np.sqrt(np.maximum(values, 0.0))[:, None]
    normal = np.random.default_rng(0).normal(size=(DRAWS, *values.shape))
    return np.sqrt(len(pairs) * np.var(np.einsum("bij,rbj->rbi", roots, normal), axis=1, ddof=1))


def report(name: str, count: int, seed: int) -> int:
    """Print a set's figures beside what chance would show; 1 where they are beyond it."""
    kit = SETS[name]
    pairs = kit.pairs()
    try:
        drawn = chance(kit, pairs)
    except InputError as error:
        print(f"{name}: {len(pairs)} pictures, refused as a whole: {error}")
        return 0
    z, refused = halves(kit, pairs, count, seed)
    found = np.sqrt(np.mean(z**2, axis=0))
    figures = {  # of the halves, and of each draw
        "pooled z": [np.sqrt(np.mean(rms**2, axis=-1)) for rms in (found, drawn)],
        f"of {kit.count} z in {LOW} to {HIGH}": [
            np.sum((rms > LOW) & (rms < HIGH), axis=-1) for rms in (found, drawn)
        ],
        **{f"z of {key}": pair for key, *pair in zip(DEPARTURE, found, drawn.T, strict=False)},
    }
    print(f"{name}, seed {seed}: {count} halves of {len(pairs)} pictures, {len(refused)} refused; "
          f"{cells.share(z):.1%} within {cells.WITHIN} u")  # fmt: skip
    for error in refused:
        print(f"  refused: {error}")
    failed = int(len(refused) > 0)
    for label, (value, draws) in figures.items():
        low, high = np.quantile(draws, RANGE)
        out = "" if low <= value <= high else "  BEYOND"
        failed += int(bool(out) and "pooled" in label)
        print(f"  {label:20s} {value:5.2f}  (by chance {low:.2f} to {high:.2f}){out}")
    return failed


if __name__ == "__main__":
    os.environ["OMP_NUM_THREADS"] = "1"
    numbers = [int(word) for word in sys.argv[1:] if word.isdigit()]
    chosen = [word for word in sys.argv[1:] if not word.isdigit()] or list(SETS)
    seed = numbers[1] if len(numbers) > 1 else cells.SEEDS[0]
    sys.exit(cells.conclude(sum(report(n, numbers[0] if numbers else COUNT, seed) for n in chosen)))
