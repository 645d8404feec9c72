"""Tables of a session, and its set-up as the report shows it; millimetres and degrees."""

from typing import Any

import numpy as np
import pandas as pd
from scipy.spatial.transform import Rotation

import robots
from verify.analysis.model import vector_length
from verify.analysis.relative_motion import RelativeMotion
from verify.analysis.results.entries import finite_number
from verify.analysis.results.summary import SessionAnalysis
from verify.core.fiducials import Marker
from verify.core.records import POSE_NAMES, Array, Measurement
from verify.core.rig import Camera, Rig
from verify.io.session.poses import Instrument
from verify.io.session.session import Session

PLACE, TURN = slice(0, 3), slice(3, 6)  # of a twist


def frames_table(measurements: list[Measurement], found: SessionAnalysis) -> pd.DataFrame:
    """docs/results.md's frames.csv: one row a stereo pair, empty figures where not measured."""
    status, comparison, joints = found.status, found.compared.comparison, found.compared.joints
    poses = [m.pose if s == "measured" else None for m, s in zip(measurements, status, strict=True)]
    known_dof = [pd.NA if pose is None else pose.known_dof for pose in poses]
    table: dict[str, Any] = {
        "frame": [m.frame for m in measurements],
        "t_s": [m.t if comparison.timed else np.nan for m in measurements],
        "status": status,
        "leds_seen": [m.leds_seen for m in measurements],
        "known_dof": pd.Series(known_dof, dtype="Int64"),  # empty, not 0, where not measured
        "reprojection_rms_px": [np.nan if p is None else p.reprojection_rms_px for p in poses],
    }
    # where LEDs leave directions open, a pose is partly the readings': it is not written
    place = np.flatnonzero([m.status == "measured" for m in measurements])[comparison.index]
    whole = np.array([b.shape[1] == 6 for b in comparison.determined], dtype=bool)
    columns = _pose_columns(comparison.base_T_measured, POSE_NAMES)
    columns = {name: np.where(whole, values, np.nan) for name, values in columns.items()}
    encoder = tuple(name.replace("_", "_encoder_") for name in POSE_NAMES)
    columns |= _pose_columns(comparison.base_T_encoder, encoder)
    undetermined = np.isnan(joints.q)
    spread = joints.inverse @ comparison.covariance_measured @ joints.inverse.swapaxes(1, 2)
    own = np.sqrt(np.diagonal(spread, axis1=1, axis2=2))
    for suffix, values in (
        ("measured_deg", joints.q),
        ("encoder_deg", comparison.q),
        ("error_deg", joints.error),
        ("u_deg", np.where(undetermined, np.nan, own)),
        ("error_u_deg", np.where(undetermined, np.nan, found.error_uncertainty)),
    ):
        columns |= {f"q{j + 1}_{suffix}": np.rad2deg(one) for j, one in enumerate(values.T)}
    position, orientation = (np.linalg.norm(comparison.xi[:, p], axis=1) for p in (PLACE, TURN))
    columns["position_error_mm"] = np.where(whole, position * 1e3, np.nan)
    columns["orientation_error_deg"] = np.where(whole, np.rad2deg(orientation), np.nan)
    for name, values in columns.items():
        table[name] = np.full(len(measurements), np.nan)
        table[name][place] = values
    labels = [""] * len(measurements)
    for row, coupling in zip(place.tolist(), joints.coupling, strict=True):
        labels[row] = coupling.label if coupling is not None else ""
    table["ambiguous_joints"] = labels
    return pd.DataFrame(table)


def _pose_columns(poses: Array, names: tuple[str, ...]) -> dict[str, Array]:
    """Places (mm) and rotation vectors (deg) of poses (n, 4, 4), a column (n,) a name."""
    turn = Rotation.from_matrix(poses[:, :3, :3]).as_rotvec()
    figures = np.concatenate([poses[:, :3, 3] * 1e3, np.rad2deg(turn)], axis=1)
    return dict(zip(names, figures.T, strict=True))


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


def resolved_table(found: SessionAnalysis) -> pd.DataFrame:
    """The resolved error of each joint, and of the flange, at each compared pair."""
    comparison, resolved = found.model.comparison, found.resolved
    table: dict[str, Array] = {
        "frame": found.frame,
        "t_s": np.where(comparison.timed, comparison.t, np.nan),
    }
    for j in range(resolved.error.shape[1]):
        table[f"q{j + 1}_resolved_deg"] = np.rad2deg(resolved.error[:, j])
        table[f"q{j + 1}_resolved_u_deg"] = np.rad2deg(resolved.uncertainty[:, j])
    twist, spread = found.resolved_flange()
    for name, part, unit in (
        ("position_resolved{}_mm", PLACE, 1e3),
        ("orientation_resolved{}_deg", TURN, 180 / np.pi),
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
        return _instrument(session, session.instrument) | {"robot": _robot(session.arm)}
    return {
        "rig": _rig(session.rig, session.frames.pan_left, session.frames.pan_right),
        "marker": _marker(session.marker),
        "robot": _robot(session.arm),
    }


def _rig(rig: Rig, pan_left: Array, pan_right: Array) -> dict[str, Any]:
    baseline = np.linalg.norm(rig.right.pan_center - rig.left.pan_center)
    return {
        "image_size_px": list(rig.image_size),
        "left": _camera(rig.left, pan_left),
        "right": _camera(rig.right, pan_right),
        "baseline_mm": float(baseline) * 1e3,
        **_base(rig),
    }


def _base(rig: Rig) -> dict[str, Any]:
    return {
        "base_source": rig.base_source,
        "base_position_mm": (rig.rig_T_base[:3, 3] * 1e3).tolist(),
        "base_rotation_vector_deg": _rotation_vector(rig.rig_T_base),
        "registration": rig.registration,
    }


def _rotation_vector(pose: Array) -> list[float]:
    """Degrees."""
    return [float(v) for v in Rotation.from_matrix(pose[:3, :3]).as_rotvec(degrees=True)]


def _instrument(session: Session, instrument: Instrument) -> dict[str, Any]:
    """Of an instrument's session what there is without cameras."""
    body, alone = instrument.flange_T_body, instrument.positions_alone
    poses = {"poses": len(instrument.poses), "positions_alone": alone}
    return {
        "instrument": {"name": instrument.name, **poses},
        "rig": {"instrument": instrument.name, **_base(session.rig)},
        "marker": {
            "source": session.marker.source,
            "point_mm": (body[:3, 3] * 1e3).tolist(),
            "body_rotation_vector_deg": None if alone else _rotation_vector(body),
        },
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
        joint: dict[str, Any] = {"joint": j + 1, "name": arm.axis_formula(j)}
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
            "lower_deg": finite_number(np.rad2deg(arm.lower[j])),
            "upper_deg": finite_number(np.rad2deg(arm.upper[j])),
        }
        joints.append({**joint, **table, **limits})
    return {
        "name": arm.name,
        "family": arm.family if isinstance(arm, robots.DhArm) else "urdf",
        "source": arm.source,
        "fingerprint": arm.fingerprint,
        "joints": joints,
    }
