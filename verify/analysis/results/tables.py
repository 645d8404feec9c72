"""Tables of a session: units at the door (mm, degrees), a row a pair, a spot, a joint.

Rig, marker and robot table as the report shows them; millimetres and degrees at the door.
"""

from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

import robots
from verify.analysis.comparison import Comparison, JointComparison
from verify.analysis.instrument import instrument_setup
from verify.analysis.joint_errors import ResolvedErrors
from verify.analysis.model import vector_length
from verify.analysis.relative_motion import RelativeMotion
from verify.core.fiducials import Marker
from verify.core.records import Array, Measurement, Pose
from verify.core.rig import Camera, Rig
from verify.io.session.session import Session

POSE = ("x_mm", "y_mm", "z_mm", "rx_deg", "ry_deg", "rz_deg")


def frames_table(
    measurements: list[Measurement],
    status: list[str],
    comparison: Comparison,
    rows: list[int],
    joints: JointComparison,
    error_uncertainty: Array,
) -> pd.DataFrame:
    """docs/results.md's frames.csv: one row a stereo pair, empty figures where it was not measured.

    Args:
        measurements: every pair's outcome, in order.
        status: what is finally said of each.
        comparison: the compared pairs.
        rows: the place of each compared pair among the measurements.
        joints: their joint angles.
        error_uncertainty: (n, j), rad, of each pair's error from all sources.
    """
    table: dict[str, Any] = {
        "frame": [m.frame for m in measurements],
        "t_s": np.array([m.t for m in measurements]),
        "status": status,
        "leds_seen": [m.leds_seen for m in measurements],
        "known_dof": _known_dof(measurements, status),
        "reprojection_rms_px": np.array(
            [
                _rms(m.pose) if s == "measured" else np.nan
                for m, s in zip(measurements, status, strict=True)
            ]
        ),
    }
    place = np.array(rows, dtype=np.int64)
    count = len(measurements)
    whole = np.array([b.shape[1] == 6 for b in comparison.determined], dtype=bool)
    measured = comparison.base_T_measured
    _pose_columns(table, count, place[whole], measured[whole], POSE)  # else partly the readings'
    encoder = tuple(n.replace("_", "_encoder_") for n in POSE)
    _pose_columns(table, count, place, comparison.base_T_encoder, encoder)
    uncertainty = np.sqrt(np.diagonal(joints.covariance_measured, axis1=1, axis2=2))
    uncertainty = np.where(np.isnan(joints.q), np.nan, uncertainty)
    for suffix, values in (
        ("measured_deg", joints.q),
        ("encoder_deg", comparison.q),
        ("error_deg", joints.error),
        ("u_deg", uncertainty),
        ("error_u_deg", np.where(np.isnan(joints.q), np.nan, error_uncertainty)),
    ):
        for j in range(values.shape[1]):
            table[f"q{j + 1}_{suffix}"] = _scatter_to_frames(count, place, np.rad2deg(values[:, j]))
    size = [np.linalg.norm(comparison.xi[:, part], axis=1) for part in (slice(0, 3), slice(3, 6))]
    table["position_error_mm"] = _scatter_to_frames(
        count, place, np.where(whole, size[0] * 1e3, np.nan)
    )
    table["orientation_error_deg"] = _scatter_to_frames(
        count, place, np.where(whole, np.rad2deg(size[1]), np.nan)
    )
    labels = [""] * count
    for row, coupling in zip(rows, joints.coupling, strict=True):
        labels[row] = coupling.label if coupling is not None else ""
    table["ambiguous_joints"] = labels
    return pd.DataFrame(table)


def _known_dof(measurements: list[Measurement], status: list[str]) -> pd.Series:
    known = [
        m.pose.known_dof if m.pose is not None and s == "measured" else pd.NA
        for m, s in zip(measurements, status, strict=True)
    ]
    return pd.Series(known, dtype="Int64")  # empty, not 0, where nothing was measured


def _rms(pose: Pose | None) -> float:
    return pose.reprojection_rms_px if pose is not None else float("nan")


def _scatter_to_frames(count: int, rows: NDArray[np.int64], values: Array) -> Array:
    column = np.full(count, np.nan)
    column[rows] = values
    return column


def _pose_columns(
    table: dict[str, Any],
    count: int,
    rows: NDArray[np.int64],
    poses: Array,
    names: tuple[str, ...],
) -> None:
    turn = Rotation.from_matrix(poses[:, :3, :3]).as_rotvec() if len(poses) else np.zeros((0, 3))
    figures = np.concatenate([poses[:, :3, 3] * 1e3, np.rad2deg(turn)], axis=1)
    for i, name in enumerate(names):
        table[name] = _scatter_to_frames(count, rows, figures[:, i])


def spots_table(measurements: list[Measurement], marker: Marker) -> pd.DataFrame:
    """One row a spot that was used or refused: where it was, and how far off the pose puts it."""
    rows: list[tuple[int, float, str, str, float, float, float, float, float, float, bool]] = []
    for m in measurements:
        if m.pose is None or m.left is None or m.right is None:
            continue
        start = 0
        for side, sighting in (("left", m.left), ("right", m.right)):
            for i, led in enumerate(sighting.led):
                x, y = sighting.centre[i].tolist()
                dx, dy = m.pose.residual[start + i].tolist()
                used = not bool(m.pose.rejected[start + i])
                peak, u = float(sighting.peak[i]), float(m.pose.spot_uncertainty[start + i])
                rows.append((m.frame, m.t, side, marker.names[led], x, y, u, dx, dy, peak, used))
            start += len(sighting)
    names = ["frame", "t_s", "camera", "led", "x_px", "y_px", "u_px",
             "residual_x_px", "residual_y_px", "peak_dn", "used"]  # fmt: skip
    return pd.DataFrame(rows, columns=names)


def resolved_table(comparison: Comparison, resolved: ResolvedErrors, frame: Array) -> pd.DataFrame:
    """The resolved error of each joint, and of the flange, at each compared pair."""
    table: dict[str, Array] = {"frame": frame, "t_s": comparison.t}
    for j in range(resolved.error.shape[1]):
        table[f"q{j + 1}_resolved_deg"] = np.rad2deg(resolved.error[:, j])
        table[f"q{j + 1}_resolved_u_deg"] = np.rad2deg(resolved.uncertainty[:, j])
    twist = np.einsum("nij,nj->ni", comparison.jacobian, resolved.error)
    spread = comparison.jacobian @ resolved.covariance @ np.swapaxes(comparison.jacobian, 1, 2)
    for name, part, unit in (
        ("position_resolved{}_mm", slice(0, 3), 1e3),
        ("orientation_resolved{}_deg", slice(3, 6), 180 / np.pi),
    ):
        size, u = vector_length(twist[:, part], spread[:, part, part])  # as the verdict takes them
        table[name.format("")] = size * unit
        table[name.format("_u")] = u * unit
    return pd.DataFrame(table)


def relative_table(found: RelativeMotion | None, frame: Array) -> pd.DataFrame:
    """One row a relative motion; `frame` (n,) numbers the compared pairs."""
    names = ["frame_early", "frame_late", "turn_deg", "turn_error_deg", "turn_u_deg"]
    names += ["advance_error_mm", "advance_u_mm"]
    if found is None:
        return pd.DataFrame(columns=names)
    turn, advance = found.error.T
    turn_u, advance_u = found.uncertainty.T
    values = [
        *(frame[found.early], frame[found.late]),
        *(np.rad2deg(found.turn), np.rad2deg(turn), np.rad2deg(turn_u)),
        *(advance * 1e3, advance_u * 1e3),
    ]
    return pd.DataFrame(dict(zip(names, values, strict=True)))


def describe(session: Session) -> dict[str, Any]:
    """Everything that a reader needs to know of the set-up, JSON-able."""
    if session.instrument is not None:
        return instrument_setup(session, session.instrument) | {"robot": _robot(session.arm)}
    return {
        "rig": _rig(session.rig, session.frames.pan_left, session.frames.pan_right),
        "marker": _marker(session.marker),
        "robot": _robot(session.arm),
    }


def _rig(rig: Rig, pan_left: Array, pan_right: Array) -> dict[str, Any]:
    baseline = np.linalg.norm(rig.right.pan_center - rig.left.pan_center)
    turn = Rotation.from_matrix(rig.rig_T_base[:3, :3]).as_rotvec(degrees=True)
    return {
        "image_size_px": list(rig.image_size),
        "left": _camera(rig.left, pan_left),
        "right": _camera(rig.right, pan_right),
        "baseline_mm": float(baseline) * 1e3,
        "base_source": rig.base_source,
        "base_position_mm": (rig.rig_T_base[:3, 3] * 1e3).tolist(),
        "base_rotation_vector_deg": turn.tolist(),
        "registration": rig.registration,
    }


def _camera(camera: Camera, pan: Array) -> dict[str, Any]:
    return {
        "fx_px": float(camera.matrix[0, 0]),
        "fy_px": float(camera.matrix[1, 1]),
        "cx_px": float(camera.matrix[0, 2]),
        "cy_px": float(camera.matrix[1, 2]),
        "distortion": camera.distortion.tolist(),
        "pan_center_mm": (camera.pan_center * 1e3).tolist(),
        "pan_min_deg": float(np.rad2deg(pan.min())),
        "pan_max_deg": float(np.rad2deg(pan.max())),
    }


def _marker(marker: Marker) -> dict[str, Any]:
    body = marker.body_standard_uncertainty
    units = ("x_mm", "y_mm", "z_mm", "rx_deg", "ry_deg", "rz_deg")
    scale = np.array([1e3] * 3 + [180 / np.pi] * 3)
    return {
        "leds": [
            {"name": name, "x_mm": x * 1e3, "y_mm": y * 1e3, "z_mm": z * 1e3, "colour": colour}
            for name, (x, y, z), colour in zip(
                marker.names, marker.leds.tolist(), marker.colours, strict=True
            )
        ],
        "led_diameter_mm": marker.led_diameter * 1e3,
        "source": marker.source,
        "datum": marker.datum,
        "body_standard_uncertainty": (
            None if body is None else dict(zip(units, (body * scale).tolist(), strict=True))
        ),
        "led_standard_uncertainty_mm": _to_mm(marker.led_standard_uncertainty),
        "centre_shift_standard_uncertainty_mm": _to_mm(marker.centre_shift_standard_uncertainty),
    }


def _to_mm(value: float | None) -> float | None:
    return None if value is None else value * 1e3


def _robot(arm: robots.Arm) -> dict[str, Any]:
    joints: list[dict[str, Any]] = []
    for j in range(arm.dof):
        joint: dict[str, Any] = {"joint": j + 1, "name": f"q{j + 1}"}
        table = dict.fromkeys(("a_mm", "d_mm", "alpha_deg", "sign", "offset_deg"))
        if isinstance(arm, robots.DhArm):
            table = {
                "a_mm": float(arm.a[j]) * 1e3,
                "d_mm": float(arm.d[j]) * 1e3,
                "alpha_deg": float(np.rad2deg(arm.alpha[j])),
                "sign": float(arm.sign[j]),
                "offset_deg": float(np.rad2deg(arm.offset[j])),
            }
        elif isinstance(arm, robots.UrdfArm):
            joint["name"] = arm.joint_names[j]
        limits = {
            "lower_deg": _finite(np.rad2deg(arm.lower[j])),
            "upper_deg": _finite(np.rad2deg(arm.upper[j])),
        }
        joints.append({**joint, **table, **limits})
    return {
        "name": arm.name,
        "family": arm.family if isinstance(arm, robots.DhArm) else "urdf",
        "source": arm.source,
        "fingerprint": arm.fingerprint,
        "joints": joints,
    }


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None
