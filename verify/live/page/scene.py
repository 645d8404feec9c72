"""Data of the page's 3D scene (arm, poses; mm), and its pictures as small JPEGs."""

from typing import Any

import cv2
import numpy as np

import robots
from verify.core.records import Array, Image

PICTURE_WIDTH = 640  # px of a picture on the page
JPEG_QUALITY = 72  # of JPEG


def joint_origins(arm: robots.Arm, q: Array) -> Array:
    """Place points along the arm in its base, (p, 3), m, at joint angles q (n,), rad.

    The base, each joint and the flange; of a DH table also the corner between d and a.
    """
    frames = robots.link_frames(arm, q[None])[0]
    if not isinstance(arm, robots.DhArm):
        return np.concatenate([np.zeros((1, 3)), frames[:, :3, 3]])
    points = [frames[0, :3, 3]]
    for before, after, (a, d, _, _) in zip(frames[:-1], frames[1:], arm.links, strict=True):
        if d and a:
            points.append(before[:3, 3] + d * before[:3, 2])
        points.append(after[:3, 3])
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


def image_size(image: Image) -> dict[str, Any]:
    """Write the size of a picture, px, as JSON has it."""
    return {"width": image.shape[1], "height": image.shape[0]}


def small_jpeg(image: Image) -> bytes:
    """Scale a picture (h, w) or (h, w, 3) down, if it is large, and encode it."""
    scale = min(PICTURE_WIDTH / image.shape[1], 1.0)
    small = cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    encoded, jpeg = cv2.imencode(".jpg", small, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
    if not encoded:
        raise ValueError("OpenCV could not encode a picture for the page as JPEG")
    return jpeg.tobytes()
