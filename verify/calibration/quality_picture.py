"""One pair rectified: the same corner must lie on the same line in both pictures."""

import cv2
import numpy as np

from verify.records import Array, Image
from verify.rig import Camera, Rig

WIDTH = 720  # px of either picture in the report
LINES = 12  # across both pictures
LINE = (80, 200, 80)  # BGR
GAP = 4  # px between the pictures


def draw_rectified(rig: Rig, left: Image, right: Image, pan: Array | None = None) -> bytes:
    """Turn both pictures to face alike and draw level lines across them.

    Args:
        rig: the rig.
        left: (h, w) grey or (h, w, 3) BGR, as taken.
        right: likewise.
        pan: (2,), rad, readings of the bases at that pair; None: the rig's own fixed ones.

    Returns:
        PNG bytes, both pictures side by side; the same input gives the same bytes.

    Source: the rectification is OpenCV's stereoRectify (Bouguet's).
    """
    angles = [rig.left.pan, rig.right.pan] if pan is None else pan.tolist()
    right_T_left = np.linalg.inv(rig.right.rig_T_camera(angles[1])) @ rig.left.rig_T_camera(
        angles[0]
    )
    turns = cv2.stereoRectify(
        rig.left.matrix, rig.left.distortion, rig.right.matrix, rig.right.distortion,
        rig.image_size, right_T_left[:3, :3], right_T_left[:3, 3:], alpha=0,
    )  # fmt: skip
    new = [np.asarray(turn, dtype=float) for turn in turns[:4]]
    pictures = [
        _turned(left, rig.left, new[0], new[2]),
        _turned(right, rig.right, new[1], new[3]),
    ]
    gap = np.full((len(pictures[0]), GAP, 3), 255, dtype=np.uint8)
    both = np.concatenate([pictures[0], gap, pictures[1]], axis=1)
    for y in np.linspace(0, len(both), LINES + 1)[1:-1]:
        cv2.line(both, (0, round(float(y))), (both.shape[1] - 1, round(float(y))), LINE, 1)
    encoded, png = cv2.imencode(".png", both)
    if not encoded:
        raise ValueError("OpenCV could not encode the preview as PNG")
    return png.tobytes()


def _turned(picture: Image, camera: Camera, turn: Array, new: Array) -> Image:
    colour = picture if picture.ndim == 3 else cv2.cvtColor(picture, cv2.COLOR_GRAY2BGR)
    height, width = picture.shape[:2]
    scale = WIDTH / width
    smaller = np.diag([scale, scale, 1.0]) @ new[:, :3]
    size = (WIDTH, round(height * scale))
    maps = cv2.initUndistortRectifyMap(
        camera.matrix, camera.distortion, turn, smaller, size, cv2.CV_32FC1
    )
    return np.asarray(cv2.remap(colour, *maps, cv2.INTER_AREA), dtype=np.uint8)
