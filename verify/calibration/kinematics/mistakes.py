"""Refuse readings that no base and target make this arm's motion, and name the usual mistake.

Base and target are free, so poses and readings cannot be laid side by side: each mistake is judged
by what a registration leaves of a few poses. It is named where as written more than MIN_LEFT is
left, and without it less than a MIN_FACTOR-th of that.
"""

from collections.abc import Iterator
from dataclasses import replace
from itertools import combinations
from pathlib import Path

import numpy as np

from verify.calibration.kinematics.chain import KinematicChain
from verify.calibration.kinematics.fit import pose_residuals
from verify.calibration.kinematics.model import start_state
from verify.calibration.kinematics.poses import IdentificationPoses, select_rows
from verify.core.records import Array
from verify.errors import InputError

MIN_LEFT = 0.02  # m, mean: an arm of 1 m with 2° in a joint leaves about as much
MIN_FACTOR = 3.0  # of what is left as written over what a mistake leaves
MAX_ROWS = 80  # that are registered for each mistake
ZERO_ERRORS_DEG = (90, -90, 180)


def refuse_mistaken_readings(file: Path, chain: KinematicChain, poses: IdentificationPoses) -> None:
    """Refuse readings of a file that fit far better once a usual mistake is taken back.

    Raises:
        InputError: names the mistake and what remains without it.
    """
    some = np.zeros(len(poses), dtype=bool)
    some[np.unique(np.linspace(0, len(poses) - 1, MAX_ROWS).astype(int))] = True
    rows = select_rows(poses, some)
    if len(np.unique(rows.base)) > 1 or len(np.unique(rows.tool)) > 1:
        return
    written = _left(chain, rows)
    if written < MIN_LEFT:
        return
    tried = [(_left(chain, replace(rows, q=q)), name, remedy) for name, remedy, q in _usual(rows.q)]
    left, name, remedy = min(tried)
    if left * MIN_FACTOR < written:
        raise InputError(
            file,
            f"the readings are not this arm's motion: {written * 1e3:.3g} mm are left of the "
            f"poses, wherever base and target are; {name} fits: {left * 1e3:.3g} mm",
            "readings in the robot file's sense, zero and order",
            remedy,
        )


def refuse_unfit(file: Path, held_out: float | None) -> None:
    """Refuse readings that nothing which was identified makes this arm's motion.

    `held_out`, m: the mean distance of positions held out; None: none were.

    Raises:
        InputError: it is more than any arm's own errors leave.
    """
    if held_out is not None and held_out > MIN_LEFT:
        raise InputError(
            file,
            f"the readings are not this arm's motion: {held_out * 1e3:.3g} mm are left of poses "
            "held out, whatever base, target and joints are",
            f"{MIN_LEFT * 1e3:.0f} mm or less: readings and poses of one arm, without slips",
            "Check units, signs and order in both files; `verify run` shows an encoder that slips.",
        )


def _left(chain: KinematicChain, rows: IdentificationPoses) -> float:
    """Mean length that a closed-form registration leaves of the positions, m."""
    left = pose_residuals(start_state(chain, rows), rows)[:, :3]
    return float(np.linalg.norm(left, axis=1).mean())


def _usual(q: Array) -> Iterator[tuple[str, str, Array]]:
    """The usual mistakes, what to do about each, and the readings (n, j), rad, without it."""
    for j in range(q.shape[1]):
        column, name = f"q{j + 1}_deg", f"joint {j + 1}"
        for what, remedy, values in (
            (f"{name} reversed", f"Multiply the column {column} by -1.", -q[:, j]),
            (f"{name} in radians", f"Multiply the column {column} by 180/π.", np.rad2deg(q[:, j])),
            *(
                (f"{name} with its zero moved by {z:+d}°", f"Add {z:+d} to {column}.",
                 q[:, j] + np.deg2rad(z))
                for z in ZERO_ERRORS_DEG
            ),
        ):  # fmt: skip
            yield what, remedy, _with(q, j, values)
    for i, k in combinations(range(q.shape[1]), 2):
        columns = f"q{i + 1}_deg and q{k + 1}_deg"
        swapped = q.copy()
        swapped[:, [i, k]] = q[:, [k, i]]
        yield f"joints {i + 1} and {k + 1} exchanged", f"Exchange {columns}.", swapped
    for sign, verb in ((1.0, "Add q{} to"), (-1.0, "Subtract q{} from")):
        for j in range(1, q.shape[1]):
            what = f"joint {j + 1} coupled to joint {j}, its link turning with both,"
            remedy = f"{verb.format(j)} q{j + 1}: this is a raw log of the motors."
            yield what, remedy, _with(q, j, q[:, j] + sign * q[:, j - 1])


def _with(q: Array, joint: int, values: Array) -> Array:
    changed = q.copy()
    changed[:, joint] = values
    return changed
