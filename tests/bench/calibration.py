"""Are a calibration's stated uncertainties true? Synthetic corners, a new rig and seed each time.

A cell is one parameter: the share of replicates whose ±1.96 u holds the truth, which must lie
within 93 to 97 %. Some replicates seem by chance to have an error that the draw does not have, and
their uncertainties allow for it: at most as often as its test states, within chance. The mean of d²
over its degrees of freedom must lie within its 99 % interval, of all and of the others.

    python -m tests.bench.calibration [REPLICATES] [SEED] [fixed|turning|scattering …]
"""

import os
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from scipy.spatial.transform import Rotation
from scipy.stats import binom, chi2

from tests.bench import cells
from tests.support.boards.made_views import BOARD, SIGMA, SIZE, levelled, make_pairs, poses
from verify.calibration.stereo.calibrate import calibrate
from verify.calibration.stereo.estimate import P_FALSE_CLUSTERING
from verify.calibration.stereo.records import covariance_in_si
from verify.calibration.stereo.scatter import MIN_LOG_LIKELIHOOD
from verify.core.rig import Camera, Rig

# Replicates of each kind. Turning bases, of which chance alarms take some 0.4 % off d², have four
# times as many: with 2,000 the 99 % interval of d² is 1.4 % to either side, and one seed missed it.
REPLICATES = {"fixed": 2000, "turning": 8000, "scattering": 2000}
PAIRS = 20
LENS = ("k1", "k2", "p1", "p2", "k3")
PAN_ERROR_DEG = 0.05  # of the readings of the kind that scatters
# errors that a calibration may name by chance, and how often
SCATTER = "pan readings: scatter by"
FALSE_ALARMS = {
    SCATTER: float(chi2.sf(2 * MIN_LOG_LIKELIHOOD, 1)) / 2,  # a scatter cannot be negative
    "errors of a pair's corners are correlated": P_FALSE_CLUSTERING,
}
P_MORE = 0.005  # that chance alone names more


@dataclass(frozen=True, slots=True)
class Replicate:
    """A calibration against its draw."""

    checked: cells.Checked
    alarms: tuple[str, ...]  # errors that it names, of FALSE_ALARMS, and the draw does not have


def random_rig(rng: np.random.Generator, turning: bool) -> Rig:
    """Draw two webcams 120 to 240 mm apart; with `turning`, axes and mounts that are not ideal."""
    baseline = rng.uniform(0.12, 0.24)
    sides = [_camera(rng, sign * baseline / 2, turning) for sign in (-1, 1)]
    return levelled(Rig(SIZE, sides[0], sides[1], np.full((4, 4), np.nan), ""), turning)


def _camera(rng: np.random.Generator, x: float, turning: bool) -> Camera:
    focal = rng.uniform(950, 1100)
    matrix = np.eye(3)
    matrix[[0, 1], [0, 1]] = focal, focal * rng.uniform(0.997, 1.003)
    matrix[:2, 2] = np.array([639.5, 359.5]) + rng.uniform(-12, 12, 2)
    distortion = rng.uniform([-0.12, -0.05, -8e-4, -8e-4, 0], [0.05, 0.08, 8e-4, 8e-4, 0])
    mount = np.eye(4)
    mount[:3, :3] = Rotation.from_rotvec(rng.uniform(-0.03, 0.03, 3)).as_matrix()
    axis = np.array([0.0, 1.0, 0.0])
    if turning:
        axis = axis + rng.uniform(-0.03, 0.03, 3)
        mount[:3, 3] = rng.uniform(-0.02, 0.02, 3)
    return Camera(
        matrix=matrix,
        distortion=distortion,
        pan_center=np.array([x, 0.0, 0.0]),
        pan_axis=axis / np.linalg.norm(axis),
        pan_zero=rng.uniform(-0.02, 0.02) if turning else 0.0,
        mount=mount,
        pan=float(-np.sign(x) * rng.uniform(0.05, 0.15)),
    )


def deviation(name: str, found: Rig, true: Rig) -> float:
    """Found less true for a parameter of [covariance], in SI units and pixels."""
    side, _, key = name.partition(".")
    one, other = (rig.left if side == "left" else rig.right for rig in (found, true))
    entry = {"fx_px": (0, 0), "fy_px": (1, 1), "cx_px": (0, 2), "cy_px": (1, 2)}.get(key)
    if entry:
        return float(one.matrix[entry] - other.matrix[entry])
    if key in LENS:
        return float((one.distortion - other.distortion)[LENS.index(key)])
    if key == "pan_zero_deg":
        return one.pan_zero - other.pan_zero
    what, axis, _ = key.rsplit("_", 2)
    at = "xyz".index(axis[-1])
    if what == "pan_center":
        return float((one.pan_center - other.pan_center)[at])
    if what == "pan_axis":
        return float(np.cross(other.pan_axis, one.pan_axis)[at])
    if axis.startswith("r"):
        turn = Rotation.from_matrix(one.mount[:3, :3] @ other.mount[:3, :3].T).as_rotvec()
        return float(turn[at])
    return float((one.mount[:3, 3] - other.mount[:3, 3])[at])


def replicate(kind: str, seed: int) -> Replicate:
    """Calibrate a rig that is drawn, and set it against the truth."""
    rng = np.random.default_rng(seed)
    turning = kind != "fixed"
    rig = random_rig(rng, turning)
    boards = poses(rng, PAIRS)
    pan = np.tile([rig.left.pan, rig.right.pan], (PAIRS, 1))
    error = np.zeros((PAIRS, 2))
    if turning:
        pan = pan + np.deg2rad(rng.uniform(-12, 12, (PAIRS, 2)))
    if kind == "scattering":
        error = np.deg2rad(rng.normal(0, PAN_ERROR_DEG, (PAIRS, 2)))
    stated = SIGMA * np.exp(rng.uniform(-0.5, 0.5))  # the stated noise is off by a factor
    pairs = make_pairs(rig, boards, rng, pan, error, stated=stated)
    found = calibrate(pairs, BOARD, SIZE)
    covariance = found.rig.covariance
    errors = np.array([deviation(name, found.rig, rig) for name in covariance.parameters])
    absent = set(FALSE_ALARMS) - ({SCATTER} if kind == "scattering" else set())
    return Replicate(
        cells.checked(covariance.parameters, errors, covariance_in_si(covariance)),
        tuple(e for e in absent if any(s.startswith(e) for s in found.decisions)),
    )


def study(kind: str, count: int, seed: int, jobs: int | None = None) -> list[Replicate]:
    """All replicates but those that were refused: a draw may lack what the data must show."""
    return cells.replicates(partial(replicate, kind), seed, count, jobs)


def _judge(title: str, outcomes: Sequence[Replicate]) -> int:
    """Print the cells of a kind; returns how many fail."""
    checked = [o.checked for o in outcomes]
    errors, failed = cells.by_name(checked), 0
    quiet = [o.checked for o in outcomes if not o.alarms]
    for whose, some in (("", checked), (", no false alarm", quiet)):
        pooled = cells.share(np.concatenate([o.z for o in some]))
        ratio, low, high = cells.d2_ratio(some)
        fine = low <= ratio <= high and cells.LOW <= pooled <= cells.HIGH
        failed += int(not fine)
        print(f"{title}{whose}: pooled {pooled:.1%}, d²/dof {ratio:.4f} (99 %: {low:.4f} to "
              f"{high:.4f}){'' if fine else '  FAILS'}")  # fmt: skip
    for alarm, often in FALSE_ALARMS.items():
        found = sum(alarm in o.alarms for o in outcomes)
        most = int(binom.ppf(1 - P_MORE, len(outcomes), often))
        failed += int(found > most)
        print(f"  false alarm, {alarm!r}: {found} of {len(outcomes)}, {often:.0%} is stated, "
              f"{most} may be{'' if found <= most else '  FAILS'}")  # fmt: skip
    for name, z in sorted(errors.items()):
        common = len(z) == len(outcomes)  # a coefficient that is mostly held is no cell
        good = cells.LOW <= cells.share(z) <= cells.HIGH or not common
        failed += int(not good)
        print(f"  {name:26s} {cells.share(z):.1%}  of {len(z)}{'' if good else '  FAILS'}")
    return failed


def main(given: int | None, seeds: tuple[int, ...], kinds: Sequence[str]) -> int:
    """Print every cell, of so many replicates if they are given; 1 where one fails."""
    failed = 0
    for seed in seeds:
        for kind in kinds:
            count = given or REPLICATES[kind]
            outcomes = study(kind, count, seed)
            failed += _judge(f"{kind}, seed {seed}, {count} replicates of {PAIRS} pairs", outcomes)
    return cells.conclude(failed)


if __name__ == "__main__":
    os.environ["OMP_NUM_THREADS"] = "1"
    numbers = [int(word) for word in sys.argv[1:] if word.isdigit()]
    chosen = (numbers[1],) if len(numbers) > 1 else cells.SEEDS
    kinds = [word for word in sys.argv[1:] if not word.isdigit()]
    sys.exit(main(numbers[0] if numbers else None, chosen, kinds or list(REPLICATES)))
