"""A fixture's TOML: where a board sits on the robot's base, and how well that is known."""

from dataclasses import dataclass
from pathlib import Path

import msgspec
import numpy as np
from scipy.spatial.transform import Rotation

from verify.core.records import Array, rigid_transform
from verify.errors import one_line
from verify.io.rig import Matrix, Triple, nearest_pose
from verify.io.toml import MM, decode, key_error, not_negative

MIN_POSITION_MM = 2.0  # no board's corner stands as near to the middle of a robot's base


class FixtureTable(msgspec.Struct, kw_only=True):
    """The keys of a fixture file; a rotation is given in one of two ways."""

    format: int
    position_mm: Triple  # the board's first inner corner in the base frame
    rotation: Matrix | None = None  # base_R_board
    rotation_vector_deg: Triple | None = None  # the same as axis times angle
    position_standard_uncertainty_mm: Triple | float | None = None  # along the base's axes
    rotation_standard_uncertainty_deg: Triple | float | None = None  # about the base's axes


@dataclass(frozen=True, slots=True)
class Fixture:
    """Where a board sits on the robot's base."""

    base_T_board: Array  # (4, 4)
    covariance: Array  # (6, 6), m and rad, perturbation on the left, base axes; 0: not stated


def read(path: str | Path) -> tuple[Fixture, tuple[str, ...]]:
    """Read and check a fixture file; warnings: unknown keys, uncertainties that are not stated.

    Raises:
        InputError: names the file, the key, what stands there, what should, and what to do.
    """
    path = Path(path)
    table, warnings = decode(path, FixtureTable)
    base_T_board = _base_T_board(path, table)
    sigma, missing = [], []
    for key, unit in (
        ("position_standard_uncertainty_mm", MM),
        ("rotation_standard_uncertainty_deg", np.pi / 180),
    ):
        given = getattr(table, key)
        if given is None:
            missing.append(key)
        values = np.broadcast_to(0.0 if given is None else np.array(given, dtype=float), 3)
        not_negative(path, key, float(values.min()))
        sigma.append(values * unit)
    if 0 < np.abs(table.position_mm).max() < MIN_POSITION_MM:
        given = f"position_mm is {list(table.position_mm)}; is that in metres?"
        warnings = (*warnings, one_line(f"{path}: {given}"))
    if missing:
        warning = f"{path}: {' and '.join(missing)} not stated; taken as exact."
        warnings = (*warnings, one_line(warning))
    return Fixture(base_T_board, np.diag(np.square(np.concatenate(sigma)))), warnings


def _base_T_board(path: Path, table: FixtureTable) -> Array:
    vector_deg = table.rotation_vector_deg
    if (table.rotation is None) == (vector_deg is None):
        both = table.rotation is not None
        found = "is given twice" if both else "is missing"
        expected = "either rotation (3 x 3) or rotation_vector_deg is expected"
        remedy = "Leave one of them out." if both else "Add one of them."
        raise key_error(path, "rotation", found, expected, remedy)
    if table.rotation is not None:
        return nearest_pose(path, "rotation", table.rotation, table.position_mm)
    turn = Rotation.from_rotvec(np.deg2rad(np.array(vector_deg))).as_matrix()
    return rigid_transform(turn, np.array(table.position_mm) * MM)
