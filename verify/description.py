"""Rig, marker and robot table as the report shows them; millimetres and degrees at the door."""

from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

import robots
from verify.instrument import instrument_setup
from verify.marker import Marker
from verify.records import Array
from verify.rig import Camera, Rig
from verify.session import Session


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
        "led_standard_uncertainty_mm": _mm(marker.led_standard_uncertainty),
        "centre_shift_standard_uncertainty_mm": _mm(marker.centre_shift_standard_uncertainty),
    }


def _mm(value: float | None) -> float | None:
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
