"""Refuse readings that no base and target make this arm's motion, and name the usual mistake.

Base and target are free, so poses and readings cannot be laid side by side: each mistake is judged
by what a registration leaves of a few poses. It is named where as written more than MIN_LEFT is
left, and without it less than a MIN_FACTOR-th of that.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np

from verify.analysis.mistakes import joint_mistakes
from verify.calibration.kinematics.chain import KinematicChain
from verify.calibration.kinematics.fit import pose_residuals
from verify.calibration.kinematics.model import start_state
from verify.calibration.kinematics.poses import IdentificationPoses, select_rows
from verify.calibration.kinematics.validation import CrossValidation
from verify.core.readings import Readings
from verify.errors import InputError

MIN_LEFT = 0.02  # m, mean: an arm of 1 m with 2° in a joint leaves about as much
MIN_FACTOR = 3.0  # of what is left as written over what a mistake leaves
MAX_ROWS = 80  # that are registered for each mistake


def refuse_mistaken_readings(file: Path, chain: KinematicChain, poses: IdentificationPoses) -> None:
    """Refuse readings of a file that fit far better once a usual mistake is taken back.

    Poses of several bases or targets are not judged: a registration of one would leave them all.

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
    readings = Readings(np.arange(len(rows), dtype=float), rows.q)
    tried = [
        (_left(chain, replace(rows, q=without.q)), name, remedy)
        for name, remedy, without in joint_mistakes(readings)
    ]
    left, name, remedy = min(tried)
    if left * MIN_FACTOR < written:
        raise InputError(
            file,
            f"the readings are not this arm's motion: {written * 1e3:.3g} mm are left of the "
            f"poses, wherever base and target are; {name} fits: {left * 1e3:.3g} mm",
            "readings in the robot file's sense, zero and order",
            remedy,
        )


def refuse_unfit(file: Path, left: CrossValidation | None) -> None:
    """Refuse readings that nothing which was identified makes this arm's motion.

    `left`: what the chosen model leaves of poses that it was not fitted to; None where no poses
    were held out, and nothing is refused.

    Raises:
        InputError: more is left of poses held out than any arm's own errors leave.
    """
    if left is not None and left.position[0] > MIN_LEFT:
        mm = float(left.position[0]) * 1e3
        found = f"{mm:.3g} mm are left of poses held out, whatever base and joints are"
        raise InputError(
            file, f"the readings are not this arm's motion: {found}",
            f"one arm's own errors leave less than {MIN_LEFT * 1e3:.0f} mm",
            "Check units, signs and order in both files; `verify run` shows an encoder that slips.",
        )  # fmt: skip


def _left(chain: KinematicChain, rows: IdentificationPoses) -> float:
    """Mean length that a closed-form registration leaves of the positions, m."""
    left = pose_residuals(start_state(chain, rows), rows)[:, :3]
    return float(np.linalg.norm(left, axis=1).mean())
