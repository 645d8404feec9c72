"""poses.csv: millimetres and unit quaternions in the file, metres and rotations inside."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from verify.core.records import Array
from verify.errors import InputError
from verify.io.series import open_table

POSITION = ("x_mm", "y_mm", "z_mm")
QUATERNION = ("qw", "qx", "qy", "qz")
POSITION_UNCERTAINTY = ("x_u_mm", "y_u_mm", "z_u_mm")
ORIENTATION_UNCERTAINTY = ("rx_u_deg", "ry_u_deg", "rz_u_deg")

TOL_NORM = 2e-3  # of a quaternion: three decimals in the file; more is another number
MAX_DECIMALS = 7  # looked for: beyond these a file is as good as exact
# Below this no instrument measures; a covariance must be greater than nothing.
EXACT = (1e-8, 1e-8)  # m, rad

_MM = 1e-3  # m


@dataclass(frozen=True, slots=True)
class Poses:
    """What an instrument measured, in its own frame: n poses, or n positions alone."""

    t: Array  # (n,), s, the instrument's clock, strictly increasing
    position: Array  # (n, 3), m
    rotation: Array | None  # (n, 3, 3); None: positions alone
    position_uncertainty: Array | None  # (n, 3), m, standard, along the file's axes; None: unstated
    orientation_uncertainty: Array | None  # (n, 3), rad, of a rotation vector applied on the left
    rounding: tuple[float, float]  # m, rad: standard uncertainty that the last decimal leaves

    def __len__(self) -> int:
        """Count the poses."""
        return len(self.t)


def read(path: str | Path, torn: bool = False) -> tuple[Poses, tuple[str, ...]]:
    """Read poses.csv: one row a pose.

    The columns may stand in any order. A quaternion and its negative are the same turn.

    Args:
        path: the file.
        torn: the recording was cut off, so the last line may be half a line; it is left out.

    Returns:
        The poses, and a warning where a half line was left out.

    Raises:
        InputError: names the file, the line and the column.
    """
    table, warnings = open_table(Path(path), torn)
    turned = _has_columns(table.header, QUATERNION)
    stated = [
        group
        for group in (POSITION_UNCERTAINTY, ORIENTATION_UNCERTAINTY)
        if _has_columns(table.header, group)
    ]
    if ORIENTATION_UNCERTAINTY in stated and not turned:
        found = f"has the column {ORIENTATION_UNCERTAINTY[0]} and no quaternion"
        remedy = "Leave it out, or export the quaternions too."
        raise InputError(f"{path}, line 1", found, "it belongs to an orientation", remedy)
    groups = [("t_s", *POSITION), QUATERNION if turned else (), *stated]
    columns = table.columns(tuple(name for group in groups for name in group))
    table.require_rising("t_s", columns["t_s"])

    def together(names: tuple[str, ...]) -> Array:
        return np.stack([columns[name] for name in names], axis=1)

    for group in stated:
        for name in group:
            wrong = np.flatnonzero(columns[name] <= 0)
            if len(wrong):
                found = f"{name} is {columns[name][wrong[0]]:g}"
                expected = "a standard uncertainty is positive"
                remedy = "Leave the column out with its like if it is unknown."
                raise table.fault(int(wrong[0]), found, expected, remedy)
    quaternion = together(QUATERNION) if turned else None
    if quaternion is not None:
        length = np.linalg.norm(quaternion, axis=1)
        off = np.flatnonzero(np.abs(length - 1) > TOL_NORM)
        if len(off):
            found = f"the quaternion has the length {length[off[0]]:.6g}"
            expected = "a turn's, qw, qx, qy, qz, has the length 1"
            raise table.fault(int(off[0]), found, expected)
    position = together(POSITION)
    return Poses(
        t=columns["t_s"],
        position=position * _MM,
        rotation=None if quaternion is None else _matrices(quaternion),
        position_uncertainty=together(POSITION_UNCERTAINTY) * _MM
        if POSITION_UNCERTAINTY in stated
        else None,
        orientation_uncertainty=np.deg2rad(together(ORIENTATION_UNCERTAINTY))
        if ORIENTATION_UNCERTAINTY in stated
        else None,
        rounding=(
            max(_rounding(position) * _MM, EXACT[0]),
            # half a turn's sine is the quaternion's vector: twice its error is the angle's
            max(EXACT[1] if quaternion is None else 2 * _rounding(quaternion), EXACT[1]),
        ),
    ), warnings


def _has_columns(header: list[str], names: tuple[str, ...]) -> bool:
    """Whether a group of columns is there; one of them asks for all of them."""
    return any(name in header for name in names)


def _matrices(quaternion: Array) -> Array:
    """Turn (n, 4) scalar-first quaternions into rotations, (n, 3, 3)."""
    matrices: Array = Rotation.from_quat(np.roll(quaternion, -1, axis=1)).as_matrix()
    return matrices


def _rounding(values: Array) -> float:
    """Standard uncertainty of numbers written with as many decimals as these seem to have."""
    for decimals in range(MAX_DECIMALS + 1):
        scaled = values * 10.0**decimals
        if np.allclose(scaled, np.round(scaled), rtol=0, atol=1e-4):
            return float(10.0**-decimals / np.sqrt(12))
    return 0.0
