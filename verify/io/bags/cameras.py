"""Make a rig from CameraInfo and tf_static: two fixed cameras, without the robot's base.

Where the right camera stands is taken from tf_static, if that links both optical frames, else from
the stereo calibration in CameraInfo: with R, the turn of a camera to the rectified frame, and
P = [f 0 cx Tx; …], the centre of a camera lies at x = -Tx / f in the rectified frame.

A transform from the arm to the cameras is not taken: a bag does not say whether it was measured by
a fixture or through the arm's own encoders, and `base_link` is seldom DH frame 0.

Source: ROS REP 104 and sensor_msgs/CameraInfo.msg.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from verify.core.records import Array, rigid_transform
from verify.core.rig import Camera, Rig
from verify.errors import InputError
from verify.io.bags.bag import TRANSFORMS, Bag, camera_info_topic

STATIC = "/tf_static"
MIN_BASELINE, MAX_BASELINE = 0.01, 10.0  # m: more is a slip of the unit
TOL_NORM = 2e-3  # of a quaternion's length
MAX_DISAGREEMENT = 0.01  # of the baseline, between tf_static and CameraInfo
PINHOLE = ("plumb_bob", "", "rational_polynomial")  # with k1, k2, p1, p2, k3 alone
RECTIFIED = "image_rect"  # in the name of a topic of rectified pictures
REMEDY = "Give the rig of these cameras: --rig rig.toml."


@dataclass(frozen=True, slots=True)
class CameraModel:
    """One CameraInfo."""

    place: str
    frame: str  # the optical frame
    size: tuple[int, int]  # width, height, px
    matrix: Array  # (3, 3), px
    distortion: Array  # (5,)
    rectified_R_camera: Array  # (3, 3)
    centre: float | None  # m, along x of the rectified frame; None: CameraInfo has no P


def rig_from_bag(bag: Bag, left: str, right: str) -> tuple[Rig, tuple[str, ...]]:
    """Make the rig of two picture topics; the notes say where its numbers come from.

    Raises:
        InputError: a topic without CameraInfo, a lens of another model, or nothing that says
            where the cameras stand.
    """
    models = [_read_model(bag, topic) for topic in (left, right)]
    if models[0].size != models[1].size:
        found = "the cameras have {} x {} and {} x {} px".format(*models[0].size, *models[1].size)
        raise InputError(bag.path, found, "a rig has two pictures of one size", REMEDY)
    by_tf, by_info = _from_transforms(bag, models), _from_projection(models)
    left_T_right = by_tf if by_tf is not None else by_info
    if left_T_right is None:
        frames = f"{models[0].frame or 'none'} and {models[1].frame or 'none'}"
        found = f"does not say where the cameras stand: {STATIC} does not link {frames}"
        raise InputError(bag.path, found, "and P of CameraInfo has no baseline", REMEDY)
    baseline = float(np.linalg.norm(left_T_right[:3, 3]))
    if not MIN_BASELINE <= baseline <= MAX_BASELINE:
        expected = f"{MIN_BASELINE:g} m to {MAX_BASELINE:g} m are plausible; ROS counts in metres"
        raise InputError(bag.path, f"has cameras {baseline:.4g} m apart", expected, REMEDY)
    source = STATIC if by_tf is not None else "P of CameraInfo"
    notes = [f"rig: CameraInfo, baseline {1e3 * baseline:.3f} mm by {source}"]
    if by_tf is not None and by_info is not None:
        apart = float(np.linalg.norm(by_tf[:3, 3] - by_info[:3, 3]))
        if apart > MAX_DISAGREEMENT * baseline:
            notes.append(
                f"{STATIC} and P of CameraInfo place the right camera {1e3 * apart:.2f} mm apart; "
                f"{STATIC} is taken."
            )
    return build_rig(models[0], models[1], left_T_right), tuple(notes)


def build_rig(left: CameraModel, right: CameraModel, left_T_right: Array) -> Rig:
    """Two fixed cameras; the rig's z is the mean optical axis, its x leads from left to right."""
    half = np.linalg.norm(left_T_right[:3, 3]) / 2
    x = left_T_right[:3, 3] / (2 * half)
    forward = np.array([0.0, 0.0, 1.0]) + left_T_right[:3, 2]
    z = forward - (forward @ x) * x
    if x[0] <= 0 or np.linalg.norm(z) < MIN_BASELINE:
        found = f"{right.place}: the right camera stands on the left"
        raise InputError("--left, --right", found, "", "Exchange the two topics.")
    z /= np.linalg.norm(z)
    rig_R_left = np.stack([x, np.cross(z, x), z])
    turns = rig_R_left, rig_R_left @ left_T_right[:3, :3]
    axis = np.array([0.0, 1.0, 0.0])
    cameras = [
        Camera(
            model.matrix, model.distortion, np.array([side * half, 0, 0]), axis, 0.0,
            rigid_transform(turn, np.zeros(3)),
        )
        for model, side, turn in zip((left, right), (-1.0, 1.0), turns, strict=True)
    ]  # fmt: skip
    return Rig(
        left.size, cameras[0], cameras[1], rig_T_base=np.full((4, 4), np.nan), base_source=""
    )


def _read_model(bag: Bag, pictures: str) -> CameraModel:
    name = camera_info_topic(bag, pictures)
    if name is None:
        expected = "a topic camera_info in the namespace of the pictures is expected"
        raise InputError(f"{bag.path}, {pictures}", "has no camera model", expected, REMEDY)
    place, info = f"{bag.path}, {name}", next(bag.messages([name])).content
    k, r, p = (np.array(_field(info, key), dtype=float).reshape(3, -1) for key in ("k", "r", "p"))
    if RECTIFIED in pictures:  # whatever lens they were taken through
        matrix, distortion, r = p[:, :3].copy(), np.zeros(5), np.eye(3)
    else:
        matrix, distortion = k, _distortion(place, info)
    if not all(np.isfinite(values).all() for values in (k, r, p, distortion)):
        raise InputError(place, "has numbers that are none", "a camera model is finite", REMEDY)
    if matrix[0, 0] <= 0 or matrix[1, 1] <= 0:
        raise InputError(place, "has no focal length", "the cameras are calibrated", REMEDY)
    if info.roi.x_offset or info.roi.y_offset or max(info.binning_x, info.binning_y) > 1:
        expected = "the model of the pictures as they are recorded is needed"
        raise InputError(place, "has a region of interest or binning", expected, REMEDY)
    turn = r if np.abs(r @ r.T - np.eye(3)).max() < 1e-6 else np.eye(3)
    return CameraModel(
        place=place,
        frame=str(info.header.frame_id).strip("/"),
        size=(int(info.width), int(info.height)),
        matrix=matrix,
        distortion=distortion,
        rectified_R_camera=turn,
        centre=float(-p[0, 3] / p[0, 0]) if p[0, 0] > 0 else None,
    )


def _field(info: Any, key: str) -> Any:
    """A matrix of CameraInfo, whose names are capitals in ROS 1."""
    return getattr(info, key) if hasattr(info, key) else getattr(info, key.upper())


def _distortion(place: str, info: Any) -> Array:
    """Coefficients k1, k2, p1, p2, k3, (5,)."""
    kind = str(info.distortion_model)
    values = np.array(_field(info, "d"), dtype=float)
    if kind not in PINHOLE or np.any(values[5:] != 0):
        expected = "k1, k2, p1, p2, k3 are expected, as in plumb_bob"
        remedy = "Calibrate the cameras with `verify calibrate boards` and give --rig rig.toml."
        raise InputError(place, f'has a lens of the model "{kind}"', expected, remedy)
    return np.resize(np.append(values[:5], np.zeros(5)), 5)


def _from_projection(models: list[CameraModel]) -> Array | None:
    """left_T_right, (4, 4), m, of the stereo calibration; None where there is no baseline."""
    left, right = models
    if left.centre is None or right.centre is None or left.centre == right.centre:
        return None
    baseline = left.rectified_R_camera.T @ np.array([right.centre - left.centre, 0.0, 0.0])
    return rigid_transform(left.rectified_R_camera.T @ right.rectified_R_camera, baseline)


def _from_transforms(bag: Bag, models: list[CameraModel]) -> Array | None:
    """left_T_right, (4, 4), m, of tf_static; None where it does not link both optical frames."""
    names = [t.name for t in bag.of_kind(TRANSFORMS) if t.name.endswith(STATIC)]
    parents: dict[str, tuple[str, Array]] = {}
    for message in bag.messages(names):
        for transform in message.content.transforms:
            parent = str(transform.header.frame_id).strip("/")
            turn = transform.transform.rotation
            length = np.linalg.norm([turn.x, turn.y, turn.z, turn.w])
            if not abs(length - 1) <= TOL_NORM:  # nor what is no number
                found = f"turns {transform.child_frame_id} by a quaternion of the length {length:g}"
                raise InputError(f"{bag.path}, {message.topic}", found, "1 is expected", REMEDY)
            parents[str(transform.child_frame_id).strip("/")] = parent, _pose(transform.transform)
    frames = [model.frame for model in models]
    if frames[0] == frames[1] or "" in frames:
        return None
    ways = [_to_root(frame, parents) for frame in frames]
    shared = next((frame for frame in ways[0] if frame in ways[1]), None)
    if shared is None:
        return None
    return np.asarray(np.linalg.inv(ways[0][shared]) @ ways[1][shared])


def _to_root(frame: str, parents: dict[str, tuple[str, Array]]) -> dict[str, Array]:
    """ancestor_T_frame, (4, 4), of a frame and of all its ancestors, the nearest first."""
    found = {frame: np.eye(4)}
    at = frame
    while at in parents and parents[at][0] not in found:
        above, placed = parents[at]
        found[above] = placed @ found[at]
        at = above
    return found


def _pose(transform: Any) -> Array:
    """Turn a geometry_msgs/Transform into (4, 4), m."""
    turn, way = transform.rotation, transform.translation
    rotation = Rotation.from_quat([turn.x, turn.y, turn.z, turn.w]).as_matrix()
    return rigid_transform(rotation, np.array([way.x, way.y, way.z]))
