"""Read poses.csv: metres and rotation matrices from millimetres and unit quaternions."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from verify.core.records import Array, rigid_transform
from verify.errors import InputError
from verify.io.series import SORT_REMEDY, CsvTable, open_table, visit_times
from verify.io.toml import MM

POSITION = ("x_mm", "y_mm", "z_mm")
QUATERNION = ("qw", "qx", "qy", "qz")
POSITION_UNCERTAINTY = ("x_u_mm", "y_u_mm", "z_u_mm")
TARGET = ("target",)
ORIENTATION_UNCERTAINTY = ("rx_u_deg", "ry_u_deg", "rz_u_deg")

TOL_NORM = 2e-3  # of a quaternion: three decimals in the file; more is another number
MAX_DECIMALS = 7  # looked for: beyond these a file is as good as exact
EXACT = (1e-8, 1e-8)  # m, rad: no instrument measures better; a covariance must be above 0


@dataclass(frozen=True, slots=True)
class Poses:
    """Poses that an instrument measured, in its own frame: n poses, or n positions alone."""

    # (n,), s, the instrument's clock, rising strictly for each target; visit_times if not timed
    t: Array
    position: Array  # (n, 3), m
    rotation: Array | None  # (n, 3, 3); None: positions alone
    position_uncertainty: Array | None  # (n, 3), m, standard, along the file's axes; None: unstated
    orientation_uncertainty: Array | None  # (n, 3), rad, of a rotation vector applied on the left
    rounding: tuple[float, float]  # m, rad: standard uncertainty that the last decimal leaves
    timed: bool = True  # False: single visits in order, whose times nobody noted
    target: Array | None = None  # (n,), number of the target that each row is of; None: one
    of_several: bool = False  # of one target of several

    @property
    def transforms(self) -> Array:
        """The body in the instrument's frame, (n, 4, 4), m; unturned where positions are alone."""
        turn = np.eye(3) if self.rotation is None else self.rotation
        return rigid_transform(turn, self.position)

    def __len__(self) -> int:
        return len(self.t)


def read(path: Path, torn: bool = False) -> tuple[Poses, tuple[str, ...]]:
    """Read poses.csv: one row a pose, or a row for each target in each pose.

    The columns may stand in any order. A quaternion and its negative are the same turn. Where the
    recording was cut off (`torn`), half a last line is left out, with a warning.

    Raises:
        InputError: names the file, the line and the column.
    """
    table, warnings = open_table(path, torn, spare="t_s")
    # one column of an optional group requires all of the group
    optional = (QUATERNION, POSITION_UNCERTAINTY, ORIENTATION_UNCERTAINTY, TARGET)
    present = [group for group in optional if any(name in table.header for name in group)]
    if ORIENTATION_UNCERTAINTY in present and QUATERNION not in present:
        found = f"has the column {ORIENTATION_UNCERTAINTY[0]} and no quaternion"
        remedy = "Leave it out, or export the quaternions too."
        raise InputError(f"{path}, line 1", found, "it belongs to an orientation", remedy)
    timed = "t_s" in table.header
    groups = [("t_s", *POSITION) if timed else POSITION, *present]
    columns = table.columns(tuple(name for group in groups for name in group))
    target = columns.get("target")
    t = columns["t_s"] if timed else _visit_times(len(columns["x_mm"]), target)
    _require_order(table, t, target)
    for name in (n for group in present for n in group if group not in (QUATERNION, TARGET)):
        wrong = np.flatnonzero(columns[name] <= 0)
        if len(wrong):
            found = f"{name} is {columns[name][wrong[0]]:g}"
            remedy = "Leave the column out with its like if it is unknown."
            raise table.fault(int(wrong[0]), found, "a standard uncertainty is positive", remedy)
    position = np.stack([columns[name] for name in POSITION], axis=1)
    quaternion, position_u, orientation_u = (
        np.stack([columns[name] for name in group], axis=1) if group in present else None
        for group in optional[:3]
    )
    rotation, rounding = None, 0.0
    if quaternion is not None:
        length = np.linalg.norm(quaternion, axis=1)
        wrong = np.flatnonzero(np.abs(length - 1) > TOL_NORM)
        if len(wrong):
            found = f"the quaternion has the length {length[wrong[0]]:.6g}"
            raise table.fault(int(wrong[0]), found, "a turn's, qw, qx, qy, qz, has the length 1")
        rotation = Rotation.from_quat(quaternion, scalar_first=True).as_matrix()
        # the quaternion's vector is the sine of half the angle: half the angle's error
        rounding = 2 * _rounding(quaternion)
    return Poses(
        t=t,
        timed=timed,
        position=position * MM,
        rotation=rotation,
        position_uncertainty=None if position_u is None else position_u * MM,
        orientation_uncertainty=None if orientation_u is None else np.deg2rad(orientation_u),
        rounding=(max(_rounding(position) * MM, EXACT[0]), max(rounding, EXACT[1])),
        target=target,
    ), warnings


def _visit_times(count: int, target: Array | None) -> Array:
    """Times of visits that nobody noted, counted for each target by itself."""
    t = visit_times(count)
    for number in () if target is None else np.unique(target):
        own = target == number
        t[own] = visit_times(int(own.sum()))
    return t


def _require_order(table: CsvTable, t: Array, target: Array | None) -> None:
    """Refuse times that do not rise, of each target by itself, and targets that are no numbers."""
    if target is None:
        table.require_rising("t_s", t)
        return
    wrong = np.flatnonzero((target < 1) | (target != np.round(target)))
    if len(wrong):
        found = f"target is {target[wrong[0]]:g}"
        raise table.fault(int(wrong[0]), found, "targets are numbered 1, 2, 3, …")
    rows = np.argsort(target, kind="stable")  # of one target after the other
    stuck = np.flatnonzero((np.diff(t[rows]) <= 0) & (np.diff(target[rows]) == 0))
    if len(stuck):
        before, row = rows[stuck[0] : stuck[0] + 2].tolist()
        found = f"t_s is {t[row]:.10g} after {t[before]:.10g} of target {target[row]:g}"
        raise table.fault(row, found, "times of a target rise strictly", SORT_REMEDY)


def _rounding(values: Array) -> float:
    """Standard uncertainty of numbers written with as many decimals as these seem to have."""
    for decimals in range(MAX_DECIMALS + 1):
        scaled = values * 10.0**decimals
        if np.allclose(scaled, np.round(scaled), rtol=0, atol=1e-4):
            return float(10.0**-decimals / np.sqrt(12))
    return 0.0
