"""Read, check and write rig.toml: both cameras, the robot's base, and their covariance.

The file holds millimetres and degrees, the `Rig` metres and radians.
"""

import re
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from scipy.linalg import polar

from verify.core.records import Array, rigid_transform
from verify.core.rig import Camera, Covariance, Rig
from verify.errors import InputError, one_line
from verify.io import toml
from verify.io.files import write_whole

SOURCES = ("fixture", "motion")
TOL_ROTATION = 1e-6  # of R'R - I: seven decimals in the file; more is a wrong matrix, not rounding
# of symmetry, unit diagonal and smallest eigenvalue: six decimals in the file; more is an error
TOL_CORRELATION = 1e-6
MIN_FOCAL_SHARE = 0.05  # of the longer side: less, as in mm, is a field of 168° and more
MAX_CENTRE_OFFSET = 0.2  # of the image's size: a principal point farther off is worth a warning
# m or rad a radian in a unit of the file (mm or deg a degree), (12, 1)
ABSORPTION_UNITS = np.tile([toml.MM * 180 / np.pi] * 3 + [1.0] * 3, 2)[:, None]

MAX_STANDARD_UNCERTAINTY = {"mm": 1e3, "deg": 180.0, "px": 1e4}  # of a parameter in that unit

Triple = tuple[float, float, float]
Matrix = tuple[Triple, Triple, Triple]

_PARAMETER = re.compile(
    r"(left|right)\.[a-z][a-z0-9_]*"
    r"|robot_base\.([xyz]_mm|r[xyz]_deg)"
    r"|led\..+\.[xyz]_mm",
    re.DOTALL,
)


class CovarianceTable(msgspec.Struct, kw_only=True):
    """The keys of [covariance]."""

    parameters: list[str]
    standard_uncertainty: list[float]
    correlation: list[list[float]]
    degrees_of_freedom: float | None = None
    temperature_c: float | None = None


def check_covariance(path: Path, table: CovarianceTable) -> Covariance:
    """Check a decoded [covariance].

    Raises:
        InputError: a name of no known form or twice, another size, a negative uncertainty, or a
            correlation that is none: not symmetric, a diagonal other than 1, not positive
            semidefinite.
    """
    names = table.parameters
    for index, name in enumerate(names):
        key = f"covariance.parameters[{index}]"
        if not _PARAMETER.fullmatch(name):
            expected = "a name is like left.fx_px, robot_base.rz_deg or led.A.x_mm"
            raise toml.key_error(path, key, f'is "{name}"', expected)
        if name in names[:index]:
            raise toml.key_error(path, key, f'repeats "{name}"', "each name may appear only once")
    for index, u in enumerate(table.standard_uncertainty):
        key = f"covariance.standard_uncertainty[{index}]"
        toml.not_negative(path, key, u)
        ending = names[index].rpartition("_")[2] if index < len(names) else ""
        if ending in MAX_STANDARD_UNCERTAINTY and u > MAX_STANDARD_UNCERTAINTY[ending]:
            most = f"at most {MAX_STANDARD_UNCERTAINTY[ending]:g} {ending} is plausible"
            raise toml.key_error(path, key, f"is {u:g}, of {names[index]}", most)
    count = len(names)
    if len(table.standard_uncertainty) != count:
        found = f"has {len(table.standard_uncertainty)} numbers"
        expected = f"there are {count} parameters"
        raise toml.key_error(path, "covariance.standard_uncertainty", found, expected)
    rows = table.correlation
    if len(rows) != count or any(len(row) != count for row in rows):
        expected = f"{count} rows of {count} are expected, one a parameter"
        raise toml.key_error(path, "covariance.correlation", "has another size", expected)
    correlation = _correlation(path, np.array(rows).reshape(count, count))
    if table.degrees_of_freedom is not None and table.degrees_of_freedom <= 0:
        found, expected = f"is {table.degrees_of_freedom}", "a positive number is expected"
        raise toml.key_error(path, "covariance.degrees_of_freedom", found, expected)
    return Covariance(
        parameters=tuple(names),
        standard_uncertainty=np.array(table.standard_uncertainty, dtype=float),
        correlation=correlation,
        degrees_of_freedom=table.degrees_of_freedom,
        temperature_c=table.temperature_c,
    )


def _correlation(path: Path, matrix: Array) -> Array:
    def refused(found: str, expected: str) -> InputError:
        remedy = "Write it with more decimals."
        return toml.key_error(path, "covariance.correlation", found, expected, remedy)

    if not len(matrix):
        return matrix
    if np.abs(matrix - matrix.T).max() > TOL_CORRELATION:
        row, column = np.unravel_index(np.abs(matrix - matrix.T).argmax(), matrix.shape)
        pair = f"{matrix[row, column]} and {matrix[column, row]}"
        found = f"has {pair} at [{row}][{column}] and [{column}][{row}]"
        raise refused(found, "a correlation is symmetric")
    if np.abs(np.diag(matrix) - 1).max() > TOL_CORRELATION:
        expected = "each parameter's correlation with itself is 1"
        raise refused("has a diagonal that is not 1", expected)
    least = float(np.linalg.eigvalsh(matrix)[0])
    if least < -TOL_CORRELATION:
        raise refused(f"has the eigenvalue {least:.2g}", "no variance is negative")
    return (matrix + matrix.T) / 2


class CameraTable(msgspec.Struct, kw_only=True):
    """The keys of [left] and [right]."""

    camera_matrix: Matrix
    distortion: tuple[float, float, float, float, float]
    pan_center_mm: Triple
    pan_axis: Triple = (0.0, 1.0, 0.0)
    pan_deg: float
    pan_zero_deg: float = 0.0
    pan_standard_uncertainty_deg: float | None = None
    mount_rotation: Matrix
    mount_offset_mm: Triple
    line_time_s: float = 0.0
    exposure_s: float | None = None


class BaseTable(msgspec.Struct, kw_only=True):
    """The keys of [robot_base]."""

    rotation: Matrix
    position_mm: Triple
    source: str
    registration: str | None = None
    absorption: list[list[float]] | None = None


class RigTable(msgspec.Struct, kw_only=True):
    """The keys of rig.toml."""

    format: int
    image_size: tuple[int, int]
    left: CameraTable
    right: CameraTable
    robot_base: BaseTable | None = None
    covariance: CovarianceTable | None = None


def read(path: Path, *, registered: bool = True) -> tuple[Rig, tuple[str, ...]]:
    """Read and check a rig.toml; warnings: unknown keys, a principal point far off the centre.

    Raises:
        InputError: names the file, the key, what stands there, what should, and what to do; with
            `registered` also of a rig without the robot's base.
    """
    table, warnings = toml.decode(path, RigTable)
    width, height = table.image_size
    if min(width, height) < 1:
        expected = "both are at least one pixel"
        raise toml.key_error(path, "image_size", f"is {width} x {height}", expected)
    if registered and table.robot_base is None:
        expected = "where the robot stands in the rig is needed here"
        remedy = "Register the robot first: `verify calibrate register`."
        raise toml.key_error(path, "robot_base", "is missing", expected, remedy)
    rig = Rig(
        image_size=table.image_size,
        left=_camera(path, "left", table.left),
        right=_camera(path, "right", table.right),
        covariance=None if table.covariance is None else check_covariance(path, table.covariance),
        **read_base(path, table.robot_base),
    )
    sides = (("left", rig.left), ("right", rig.right))
    off = [_check_intrinsics(path, *side, rig.image_size) for side in sides]
    return rig, (*warnings, *off[0], *off[1])


def encode(rig: Rig) -> bytes:
    """Write a rig as the text of a rig.toml; what is None stays out."""
    covariance = rig.covariance
    return toml.encode(
        {
            "format": toml.FORMAT,
            "image_size": list(rig.image_size),
            "left": _camera_table(rig.left),
            "right": _camera_table(rig.right),
            "robot_base": _base_table(rig) if rig.registered else None,
            "covariance": None if covariance is None else _covariance_table(covariance),
        }
    )


def _covariance_table(covariance: Covariance) -> dict[str, Any]:
    return {
        "parameters": list(covariance.parameters),
        "standard_uncertainty": toml.encode_numbers(covariance.standard_uncertainty),
        "correlation": toml.encode_numbers(covariance.correlation),
        "degrees_of_freedom": covariance.degrees_of_freedom,
        "temperature_c": covariance.temperature_c,
    }


def _base_table(rig: Rig) -> dict[str, Any]:
    return {
        "rotation": toml.encode_numbers(rig.rig_T_base[:3, :3]),
        "position_mm": toml.encode_numbers(rig.rig_T_base[:3, 3], toml.MM),
        "source": rig.base_source,
        "registration": rig.registration,
        "absorption": toml.encode_numbers(rig.absorption, ABSORPTION_UNITS),
    }


def write(path: Path, rig: Rig) -> None:
    """Write a rig.toml, whole or not at all; raises InputError where the system refuses it."""
    write_whole(path, encode(rig))


def read_base(path: Path, base: BaseTable | None) -> dict[str, Any]:
    """Convert [robot_base] to the fields of a `Rig`; nan where there is none."""
    if base is None:
        return {"rig_T_base": np.full((4, 4), np.nan), "base_source": ""}
    return {
        "rig_T_base": nearest_pose(path, "robot_base.rotation", base.rotation, base.position_mm),
        "base_source": toml.one_of(path, "robot_base.source", base.source, SOURCES),
        "registration": base.registration,
        "absorption": _absorption(path, base.absorption),
    }


def _camera(path: Path, side: str, table: CameraTable) -> Camera:
    k = np.array(table.camera_matrix)
    if k[1, 0] != 0 or k[2].tolist() != [0.0, 0.0, 1.0]:
        expected = "expected is [[fx, skew, cx], [0, fy, cy], [0, 0, 1]]"
        raise toml.key_error(path, f"{side}.camera_matrix", "is not a camera matrix", expected)
    axis_length = float(np.linalg.norm(table.pan_axis))
    if axis_length < TOL_ROTATION:
        raise toml.key_error(path, f"{side}.pan_axis", "has no length", "a direction is expected")
    for key in ("pan_standard_uncertainty_deg", "line_time_s", "exposure_s"):
        toml.not_negative(path, f"{side}.{key}", getattr(table, key))
    mount = nearest_pose(
        path, f"{side}.mount_rotation", table.mount_rotation, table.mount_offset_mm
    )
    return Camera(
        matrix=k,
        distortion=np.array(table.distortion),
        pan_center=np.array(table.pan_center_mm) * toml.MM,
        pan_axis=np.array(table.pan_axis) / axis_length,
        pan_zero=float(np.deg2rad(table.pan_zero_deg)),
        mount=mount,
        pan=float(np.deg2rad(table.pan_deg)),
        pan_standard_uncertainty=toml.scaled(table.pan_standard_uncertainty_deg, np.pi / 180),
        line_time=table.line_time_s,
        exposure=table.exposure_s,
    )


def _camera_table(camera: Camera) -> dict[str, Any]:
    u = camera.pan_standard_uncertainty
    return {
        "camera_matrix": toml.encode_numbers(camera.matrix),
        "distortion": toml.encode_numbers(camera.distortion),
        "pan_center_mm": toml.encode_numbers(camera.pan_center, toml.MM),
        "pan_axis": toml.encode_numbers(camera.pan_axis),
        "pan_deg": toml.encode_numbers(np.rad2deg(camera.pan)),
        "pan_zero_deg": toml.encode_numbers(np.rad2deg(camera.pan_zero)),
        "pan_standard_uncertainty_deg": None if u is None else toml.encode_numbers(np.rad2deg(u)),
        "mount_rotation": toml.encode_numbers(camera.mount[:3, :3]),
        "mount_offset_mm": toml.encode_numbers(camera.mount[:3, 3], toml.MM),
        "line_time_s": camera.line_time,
        "exposure_s": camera.exposure,
    }


def nearest_pose(path: Path, key: str, rotation: Matrix, position_mm: Triple) -> Array:
    """Build a motion, (4, 4), m, from the orthonormal matrix nearest to the file's rotation.

    Raises:
        InputError: the matrix is none to rounding, or a reflection.
    """
    matrix = np.array(rotation)
    off = float(np.abs(matrix.T @ matrix - np.eye(3)).max())
    if off > TOL_ROTATION:
        expected = "rows of unit length at right angles are expected"
        remedy = "Write it with at least seven decimals."
        raise toml.key_error(path, key, f"is not a rotation: off by {off:.1e}", expected, remedy)
    if np.linalg.det(matrix) < 0:
        expected = "a right-handed rotation is expected"
        raise toml.key_error(path, key, "is a reflection", expected, "Turn the sign of one axis.")
    return rigid_transform(polar(matrix)[0], np.array(position_mm) * toml.MM)


def _check_intrinsics(path: Path, side: str, camera: Camera, size: tuple[int, int]) -> list[str]:
    """Refuse what no camera of such images has; warn of a principal point far off the centre."""
    warnings = []
    key, least = f"{side}.camera_matrix", MIN_FOCAL_SHARE * max(size)
    for axis, name, extent in ((0, "cx", size[0]), (1, "cy", size[1])):
        focal, at = camera.matrix[axis, [axis, 2]]
        if focal < least:
            expected = f"a focal length in pixels is {least:.0f} px or more at that image size"
            raise toml.key_error(path, key, f"has f{'xy'[axis]} = {focal} px", expected)
        if not -0.5 <= at <= extent - 0.5:  # pixel centres at whole numbers
            found = f"has {name} = {at} px, outside an image of {size[0]} x {size[1]}"
            expected = "the optical axis meets the sensor"
            raise toml.key_error(path, key, found, expected, "Compare it with image_size.")
        centre = (extent - 1) / 2
        if abs(at - centre) > MAX_CENTRE_OFFSET * extent:
            off = f"is more than {MAX_CENTRE_OFFSET:.0%} of the image off its centre, {centre} px"
            note = f"{path}, {key}: {name} = {at} px {off}. Is image_size right?"
            warnings.append(one_line(note))
    return warnings


def _absorption(path: Path, rows: list[list[float]] | None) -> Array | None:
    if rows is None:
        return None
    widths = {len(row) for row in rows}
    if len(rows) != 12 or len(widths) != 1 or 0 in widths:
        expected = "12 rows are expected, six of the base and six of the LEDs, one column a joint"
        raise toml.key_error(path, "robot_base.absorption", f"has {len(rows)} rows", expected)
    return np.asarray(np.array(rows) * ABSORPTION_UNITS)
