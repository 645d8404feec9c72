"""Tables of a calibration's results, in mm, degrees and px."""

from typing import Any

import numpy as np
import pandas as pd
from scipy.spatial.transform import Rotation

from robots.transforms import carry
from verify.calibration.origin import DEG, MM, POSE_UNITS
from verify.calibration.quality.accuracy import uncertainty_maps
from verify.calibration.quality.coverage import view_frame
from verify.calibration.quality.quality import CalibrationQuality
from verify.calibration.stereo.parameters import PAR_LENS, PARAMETER_KEYS
from verify.calibration.stereo.records import Calibration
from verify.core.records import POSE_NAMES, SIDES, Array
from verify.core.rig import Camera

UNIT = {"mm": "mm", "deg": "°", "px": "px"}
FRUSTUM = 0.15  # of the working distance: how far a camera's pyramid reaches into the picture


def tables(calibration: Calibration, quality: CalibrationQuality) -> dict[str, pd.DataFrame]:
    """Every table of the results."""
    return {
        "parameters": _parameters(calibration),
        "views": _views(quality),
        "residuals": _residuals(calibration),
        "boards": _boards(calibration, quality),
        "coverage": _coverage(quality),
        "accuracy": _accuracy(quality),
        "contributions": pd.DataFrame(
            [
                {"group": c.group, "alone_mm": c.alone * MM, "without_mm": c.without * MM}
                for c in quality.contributions
            ]
        ),
        "scene": _scene(calibration, quality),
    }


def _parameters(calibration: Calibration) -> pd.DataFrame:
    """Every parameter of the rotating-base model; `state` says whether it was found, or held."""
    given = calibration.rig.covariance
    stated = {} if given is None else given.by_name
    rows = []
    for side, camera in (("left", calibration.rig.left), ("right", calibration.rig.right)):
        values = _values(camera)
        for key in PARAMETER_KEYS:
            u, unit = stated.get(f"{side}.{key}", 0.0), UNIT.get(key.rpartition("_")[2], "")
            known = (u, "found") if u > 0 else (np.nan, "gauge")
            rows.append((side, key, unit, values[key], *known))
    columns = ["camera", "parameter", "unit", "value", "standard_uncertainty", "state"]
    return pd.DataFrame(rows, columns=columns)


def _values(camera: Camera) -> dict[str, float]:
    """A camera's parameters in the units of their names.

    The pan axis is given by the turn that carries the rig's y axis to it.
    """
    k = camera.matrix
    values = {"fx_px": k[0, 0], "fy_px": k[1, 1], "cx_px": k[0, 2], "cy_px": k[1, 2]}
    values |= dict(zip(PARAMETER_KEYS[PAR_LENS], camera.distortion.tolist(), strict=True))
    axis = np.cross([0.0, 1.0, 0.0], camera.pan_axis)
    sine = float(np.linalg.norm(axis))
    turn = axis / sine * np.arctan2(sine, camera.pan_axis[1]) if sine > 0 else np.zeros(3)
    vectors = {
        "pan_center_{}_mm": camera.pan_center * MM,
        "pan_axis_r{}_deg": turn * DEG,
        "mount_r{}_deg": Rotation.from_matrix(camera.mount[:3, :3]).as_rotvec() * DEG,
        "mount_{}_mm": camera.mount[:3, 3] * MM,
    }
    for pattern, vector in vectors.items():
        values |= {pattern.format(a): v for a, v in zip("xyz", vector.tolist(), strict=True)}
    values["pan_zero_deg"] = camera.pan_zero * DEG
    return {key: float(value) for key, value in values.items()}


def _views(quality: CalibrationQuality) -> pd.DataFrame:
    columns = ["camera", "frame", "corners", "refused", "rms_px", "largest_px"]
    columns += ["mean_x_px", "mean_y_px", "poor"]
    rows = [
        (SIDES[v.camera], v.frame, v.corners, v.refused, v.rms, v.largest, *v.mean, v.poor)
        for v in quality.views
    ]
    return pd.DataFrame(rows, columns=columns)


def _residuals(calibration: Calibration) -> pd.DataFrame:
    found = calibration.residuals
    return pd.DataFrame(
        {
            "camera": [SIDES[c] for c in found.camera.tolist()],
            "frame": found.frame,
            "corner": found.corner,
            "x_px": found.observed[:, 0],
            "y_px": found.observed[:, 1],
            "residual_x_px": found.residual[:, 0],
            "residual_y_px": found.residual[:, 1],
            "u_px": found.uncertainty,
            "used": found.used,
        }
    )


def _boards(calibration: Calibration, quality: CalibrationQuality) -> pd.DataFrame:
    """Pose of each board in the rig, standard uncertainty, distance and tilts."""
    poses = calibration.rig_T_board
    turn = Rotation.from_matrix(poses[:, :3, :3]).as_rotvec()
    values = np.concatenate([poses[:, :3, 3], turn], axis=1) * POSE_UNITS
    u = np.sqrt(np.diagonal(calibration.board_covariance, axis1=1, axis2=2)) * POSE_UNITS
    table: dict[str, Any] = {"frame": calibration.frames}
    table |= {name: values[:, i] for i, name in enumerate(POSE_NAMES)}
    table |= {f"u_{name}": u[:, i] for i, name in enumerate(POSE_NAMES)}
    table["distance_mm"] = [s.distance * MM for s in quality.orientations]
    for name in ("tilt", "about_horizontal", "about_vertical"):
        table[f"{name}_deg"] = [getattr(s, name) * DEG for s in quality.orientations]
    return pd.DataFrame(table)


def _coverage(quality: CalibrationQuality) -> pd.DataFrame:
    rows = [
        {"camera": SIDES[c.camera], "x_px": x, "y_px": y, "corners": int(c.counts[i, j])}
        for c in quality.coverage
        for i, y in enumerate(c.y.tolist())
        for j, x in enumerate(c.x.tolist())
    ]
    return pd.DataFrame(rows)


def _accuracy(quality: CalibrationQuality) -> pd.DataFrame:
    """Standard uncertainty of a point, a row a point of each map; empty where it is not visible."""
    tables = []
    for field in quality.fields:
        x, y = np.meshgrid(field.x, field.y)
        table = {
            "distance_mm": np.full(x.size, field.distance * MM),
            "x_mm": x.ravel() * MM,
            "y_mm": y.ravel() * MM,
        }
        table |= {name: values.ravel() for name, values in uncertainty_maps(field).items()}
        tables.append(pd.DataFrame(table))
    return pd.concat(tables, ignore_index=True)


def _scene(calibration: Calibration, quality: CalibrationQuality) -> pd.DataFrame:
    """Outlines of boards and cameras as the view's frame has them, a closed line an item."""
    board = calibration.board
    square = board.square
    low, high = -square, np.array([board.columns, board.rows]) * square
    edge = np.array(
        [[low, low, 0], [high[0], low, 0], [high[0], high[1], 0], [low, high[1], 0], [low, low, 0]]
    )
    items = [
        ("board", str(orientation.frame), carry(orientation.view_T_board, edge))
        for orientation in quality.orientations
    ]
    view_T_rig = np.linalg.inv(view_frame(calibration.rig, quality.pan))
    for side, camera, pan in zip(
        SIDES, (calibration.rig.left, calibration.rig.right), quality.pan.tolist(), strict=True
    ):
        reach = FRUSTUM * quality.working_distance
        pyramid = _pyramid(camera, calibration.rig.image_size) * reach
        items.append(("camera", side, carry(view_T_rig @ camera.rig_T_camera(pan), pyramid)))
    rows = [
        {"kind": kind, "name": name, "x_mm": x * MM, "y_mm": y * MM, "z_mm": z * MM}
        for kind, name, line in items
        for x, y, z in line.tolist()
    ]
    return pd.DataFrame(rows)


def _pyramid(camera: Camera, size: tuple[int, int]) -> Array:
    """One stroke along a pyramid from the optical centre to the image's corners, unit depth."""
    corners = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    corners *= [size[0] - 1, size[1] - 1]
    a, b, c, d = np.column_stack([camera.normalise(corners), np.ones(4)])
    tip = np.zeros(3)
    return np.array([tip, a, b, tip, c, d, tip, a, d, c, b])
