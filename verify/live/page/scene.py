"""Data of the page's 3D scene (arm, poses; mm), and its pictures as small JPEGs."""

from typing import Any

import cv2
import numpy as np
import pinocchio

import robots
from robots.arm import DhArm, UrdfArm
from verify.core.records import Array, Image


def joint_origins(arm: robots.Arm, q: Array) -> Array:
    """Points along the arm in its base frame, (n + 1, 3), m, for joint angles q (n,), rad."""
    if isinstance(arm, UrdfArm):
        return _of_urdf(arm, q)
    assert isinstance(arm, DhArm)
    frame = np.eye(4)
    points = [np.zeros(3)]
    for theta, (a, d, cosine, sine) in zip(arm.theta(q).tolist(), arm.links, strict=True):
        c, s = np.cos(theta), np.sin(theta)
        if d and a:  # the corner between the two, as the link is built
            points.append(frame[:3, 3] + d * frame[:3, 2])
        frame = frame @ np.array(
            [
                [c, -s * cosine, s * sine, a * c],
                [s, c * cosine, -c * sine, a * s],
                [0.0, sine, cosine, d],
                [0.0, 0.0, 0.0, 1.0],
            ]
        )
        points.append(frame[:3, 3].copy())
    return np.array(points)


def millimetres(metres: Array) -> list[list[float]]:
    """Write points (n, 3), m, as JSON has them."""
    rounded: list[list[float]] = np.round(metres * 1e3, 2).tolist()
    return rounded


def pose_fields(a_T_b: Array) -> dict[str, Any]:
    """Write a pose (4, 4), m, as JSON has it."""
    return {
        "rotation": np.round(a_T_b[:3, :3], 6).tolist(),
        "at_mm": millimetres(a_T_b[None, :3, 3])[0],
    }


def _of_urdf(arm: UrdfArm, q: Array) -> Array:
    data = arm.model.createData()  # the arm's own is the measurement's
    pinocchio.framesForwardKinematics(arm.model, data, arm.configuration(q))
    base = data.oMf[arm.base_frame]
    points = [np.zeros(3)]
    points += [
        base.actInv(data.oMi[arm.model.getJointId(name)].translation) for name in arm.joint_names
    ]
    points.append(base.actInv(data.oMf[arm.tip_frame].translation))
    return np.array(points)


PICTURE_WIDTH = 640  # px of a picture on the page
JPEG_QUALITY = 72  # of JPEG


def small_jpeg(image: Image) -> bytes:
    """Scale a picture (h, w) or (h, w, 3) down, if it is large, and encode it."""
    scale = min(PICTURE_WIDTH / image.shape[1], 1.0)
    small = cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    encoded, jpeg = cv2.imencode(".jpg", small, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
    if not encoded:
        raise ValueError("OpenCV could not encode a picture for the page as JPEG")
    return jpeg.tobytes()
