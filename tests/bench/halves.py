"""Random halves of real board pictures against each other, and what chance alone would show.

Each half is calibrated from scratch, z = (a - b) / sqrt(u_a² + u_b²) for each parameter; rms of z
over the halves. All halves are of the same few pictures, so that rms of z scatters however true
the uncertainties are: its range (5 to 95 %) is simulated, with corners that err exactly as stated.
A half that is refused is calibrated all the same and set against the whole set: a refusal is right
where a parameter is off by more than 3 of its own u; halves that are let through and as far off are
named. A set fails where its pooled z is beyond its range, more single z are beyond theirs than
chance explains, or a refusal is wrong.

    python -m tests.bench.halves [COUNT] [SEED] [SET …]
"""

import os
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from unittest.mock import patch

import cv2
import numpy as np

from tests.bench import cells
from tests.support.beside import shared
from tests.support.boards.calibrated import departure, departure_covariance
from tests.support.boards.made_views import found_pairs
from verify.calibration.quality.accuracy import parameter_derivatives
from verify.calibration.stereo import bundle, gauge, refusals
from verify.calibration.stereo.calibrate import calibrate, stack_corners
from verify.calibration.stereo.estimate import inverse_root
from verify.calibration.stereo.gauge import BASE_FIXED, AdjustmentModel
from verify.calibration.stereo.parameters import PARAMETER_NAMES, BundleState
from verify.calibration.stereo.prior import prior_rows
from verify.calibration.stereo.records import Calibration
from verify.calibration.stereo.start import start_lens
from verify.core.fiducials import Board, BoardPair, BoardView
from verify.core.records import Array
from verify.errors import InputError

COUNT, DRAWS, RANGE = 50, 400, (0.05, 0.95)
LOW, HIGH = 0.8, 1.3  # of rms of z
MOST_OFF = 3.0  # u, of a half from the whole set
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


@dataclass(frozen=True, slots=True, eq=False)
class Outcome:
    """A calibration from some of the pictures, and why it would be refused."""

    found: Calibration
    refusal: str  # "": it is not

    def off(self, other: Calibration, count: int) -> Array:
        """Parameters less another calibration's, over their own u, (count,)."""
        u = np.sqrt(np.diag(departure_covariance(self.found)))
        return (departure(self.found.rig, other.rig) / u)[:count]

    def worst(self, whole: Calibration, count: int) -> str:
        """What is farthest off the whole set's, and the focal length."""
        off, focal = self.off(whole, count), whole.rig.left.matrix[0, 0]
        at, share = int(np.argmax(np.abs(off))), self.found.rig.left.matrix[0, 0] / focal - 1
        return (
            f"{DEPARTURE[at]} is off by {off[at]:+.1f} u, left.fx by {off[0]:+.1f} u ({share:+.1%})"
        )


def calibrated(kit: BoardSet, pairs: Sequence[BoardPair]) -> Outcome:
    """Calibrate, whether or not the focal length or principal point is known well enough."""
    try:
        return Outcome(kit.calibrate(pairs), "")
    except InputError as error:
        with patch.object(refusals, "refuse_undetermined"):
            return Outcome(kit.calibrate(pairs), str(error))


def halves(
    kit: BoardSet, pairs: Sequence[BoardPair], count: int, seed: int
) -> list[tuple[Outcome, Outcome]]:
    """Random halves, calibrated."""
    rng, found = np.random.default_rng(seed), []
    for _ in range(count):
        mixed = [pairs[i] for i in rng.permutation(len(pairs))]
        half = len(mixed) // 2
        found.append((calibrated(kit, mixed[:half]), calibrated(kit, mixed[half:])))
    return found


def difference(one: Outcome, other: Outcome, count: int) -> Array:
    """Two halves' parameters less each other's, over their standard uncertainty, (count,)."""
    both = departure_covariance(one.found) + departure_covariance(other.found)
    return (departure(one.found.rig, other.found.rig) / np.sqrt(np.diag(both)))[:count]


def chance(kit: BoardSet, pairs: Sequence[BoardPair], whole: Calibration) -> Array:
    """Rms of z (DRAWS, p) over all halves of pictures that err exactly as stated.

    To first order a parameter's error is the sum of what each picture moves it by, drawn from its
    own information; halves differ by these with random signs, as many of either.
    """
    rig, every = whole.rig, kit.every(pairs)
    corners = stack_corners(every, kit.board)
    state = BundleState(rig.left, rig.right, whole.rig_T_board, np.zeros((len(every), 8)))
    bases = BASE_FIXED, BASE_FIXED
    prior = prior_rows(state, bases, kit.size, whole.noise**2)
    model = AdjustmentModel(bases, prior=prior, bowed=True)
    system = bundle.normal_equations(state, corners, model, np.ones(len(corners)))
    basis = gauge.free_directions(gauge.constraints(state, model, corners.pan[0]))
    slope = parameter_derivatives(lambda other: departure(other, rig), rig, PARAMETER_NAMES)
    root = inverse_root(basis.T @ system.total @ basis)
    gain = slope.T[: kit.count] @ basis[: len(slope)] @ root.T @ root
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
    whole = calibrated(kit, pairs)
    drawn, splits = chance(kit, pairs, whole.found), halves(kit, pairs, count, seed)
    z = np.array(
        [
            difference(*s, kit.count)
            for s in splits
            if whole.refusal or not any(h.refusal for h in s)
        ]
    )
    found = np.sqrt(np.mean(z**2, axis=0))
    least, most = np.quantile(drawn, RANGE, axis=0)
    figures = {  # of the halves, and of each draw
        "pooled z": [np.sqrt(np.mean(rms**2, axis=-1)) for rms in (found, drawn)],
        f"of {kit.count} z in {LOW} to {HIGH}": [
            np.sum((rms > LOW) & (rms < HIGH), axis=-1) for rms in (found, drawn)
        ],
        f"of {kit.count} z beyond": [
            np.sum((rms < least) | (rms > most), axis=-1) for rms in (found, drawn)
        ],
        **{f"z of {key}": pair for key, *pair in zip(DEPARTURE, found, drawn.T, strict=False)},
    }
    refused = [half for split in splits for half in split if half.refusal]
    far = [half for split in splits for half in split
           if np.abs(half.off(whole.found, kit.count)).max() > MOST_OFF]  # fmt: skip
    let = [half for half in far if not half.refusal]
    print(f"{name}, seed {seed}: {count} splits of {len(pairs)} pictures, {len(refused)} halves "
          f"refused; {cells.share(z):.1%} within {cells.WITHIN} u")  # fmt: skip
    if whole.refusal:
        print(
            f"  refused as a whole, its halves set against each other all the same: {whole.refusal}"
        )
    else:
        for half in refused:
            word = "rightly" if half in far else "WRONGLY"
            print(f"  refused {word}: forced through, {half.worst(whole.found, kit.count)}")
    for half in let:
        print(f"  let through: {half.worst(whole.found, kit.count)}")
    failed = 0 if whole.refusal else sum(half not in far for half in refused)
    for label, (value, draws) in figures.items():
        low, high = np.quantile(draws, RANGE)
        out = "" if low <= value <= high else "  BEYOND"
        many = "beyond" in label and value > high
        failed += int(many or (bool(out) and "pooled" in label))
        print(f"  {label:20s} {value:5.2f}  (by chance {low:.2f} to {high:.2f}){out}")
    return failed


if __name__ == "__main__":
    os.environ["OMP_NUM_THREADS"] = "1"
    numbers = [int(word) for word in sys.argv[1:] if word.isdigit()]
    chosen = [word for word in sys.argv[1:] if not word.isdigit()] or list(SETS)
    seed = numbers[1] if len(numbers) > 1 else cells.SEEDS[0]
    sys.exit(cells.conclude(sum(report(n, numbers[0] if numbers else COUNT, seed) for n in chosen)))
