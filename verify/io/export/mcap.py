"""Write MCAP with ROS 2 messages, as Foxglove and PlotJuggler open them.

| topic | message |
|---|---|
| /joint_states/NAME | sensor_msgs/JointState, rad |
| /flange/NAME | geometry_msgs/PoseStamped in robot_base, m |
| /left/image_raw, /right/image_raw | sensor_msgs/Image; /compressed: JPEGs of the session |
| /left/camera_info, /right/camera_info | sensor_msgs/CameraInfo, of fixed cameras |
| /tf_static | where fixed cameras and the robot stand in the rig |

Source: MCAP specification, and its registry's profile ros2.
"""

from collections.abc import Iterator
from heapq import merge
from operator import itemgetter
from pathlib import Path
from typing import Any

import numpy as np
from mcap.writer import CompressionType, Writer
from rosbags.typesys import Stores, get_typestore
from scipy.spatial.transform import Rotation

from verify.core.records import Array, Image, Progress
from verify.core.rig import Camera
from verify.core.version import __version__
from verify.io.export.content import AngleSeries, ExportContent, PoseSeries
from verify.io.session.session import Session
from verify.io.video import Video

SECOND = 1_000_000_000  # ns
RIG, BASE = "rig", "robot_base"
TOL_STILL = 1e-9  # rad: a camera that turns less stands still

Message = tuple[int, str, str, Any]  # ns since 1970, topic, type, content


class MessageFactory:
    """Makes ROS 2 messages."""

    def __init__(self, content: ExportContent) -> None:
        self.store = get_typestore(Stores.ROS2_HUMBLE)
        self._start = round(content.started.timestamp() * 1e6) * 1000  # the date has microseconds

    def time(self, t: float) -> int:
        """Turn a session's time, s, into ns since 1970."""
        return self._start + round(t * SECOND)

    def make(self, kind: str, /, **fields: Any) -> Any:
        """Make a message of a kind, like `PoseStamped`."""
        name = next(name for name in self.store.types if name.endswith(f"/msg/{kind}"))
        return self.store.types[name](**fields)

    def header(self, time: int, frame: str) -> Any:
        """Make a header."""
        stamp = self.make("Time", sec=time // SECOND, nanosec=time % SECOND)
        return self.make("Header", stamp=stamp, frame_id=frame)

    def transform(self, parent: str, child: str, pose: Array, time: int) -> Any:
        """Make a TransformStamped of a pose (4, 4), m."""
        x, y, z, w = Rotation.from_matrix(pose[:3, :3]).as_quat().tolist()
        way = self.make("Vector3", **dict(zip("xyz", pose[:3, 3].tolist(), strict=True)))
        turn = self.make("Quaternion", x=x, y=y, z=z, w=w)
        inner = self.make("Transform", translation=way, rotation=turn)
        header = self.header(time, parent)
        return self.make("TransformStamped", header=header, child_frame_id=child, transform=inner)


def write_mcap(content: ExportContent, path: Path, progress: Progress) -> None:
    """Write a file; one picture of each camera is in memory.

    Raises:
        InputError: a picture cannot be decoded.
    """
    factory = MessageFactory(content)
    names = content.joint_names
    streams = [_joint_messages(name, s, names, factory) for name, s in content.joints.items()]
    streams += [_pose_messages(name, s, factory) for name, s in content.poses.items()]
    total = sum(len(series.t) for series in content.joints.values())
    total += sum(len(series.t) for series in content.poses.values())
    if content.session is not None:
        total += 2 * len(content.session)
        streams += [iter(_still_messages(content.session, factory))]
        streams += [_picture_messages(content.session, side, factory) for side in (0, 1)]
    channels: dict[str, int] = {}
    schemas: dict[str, int] = {}
    with path.open("wb") as file:
        writer = Writer(file, compression=CompressionType.ZSTD)
        writer.start(profile="ros2", library=f"verify {__version__}")
        for number, (time, topic, kind, message) in enumerate(
            merge(*streams, key=itemgetter(0)), start=1
        ):
            if kind not in schemas:
                text = factory.store.generate_msgdef(kind, ros_version=2)[0]
                schemas[kind] = writer.register_schema(kind, "ros2msg", text.encode())
            if topic not in channels:
                channels[topic] = writer.register_channel(topic, "cdr", schemas[kind])
            data = bytes(factory.store.serialize_cdr(message, kind))
            writer.add_message(channels[topic], log_time=time, data=data, publish_time=time)
            progress(min(number, total), total)
        writer.finish()  # type: ignore[no-untyped-call]  # mcap does not annotate it


def _joint_messages(
    name: str, series: AngleSeries, joints: tuple[str, ...], factory: MessageFactory
) -> Iterator[Message]:
    none = np.zeros(0)
    for t, angles in zip(series.t.tolist(), series.q, strict=True):
        time = factory.time(t)
        message = factory.make(
            "JointState", header=factory.header(time, ""), name=list(joints),
            position=angles, velocity=none, effort=none,
        )  # fmt: skip
        yield time, f"/joint_states/{name}", "sensor_msgs/msg/JointState", message


def _pose_messages(name: str, series: PoseSeries, factory: MessageFactory) -> Iterator[Message]:
    rows = np.column_stack([series.t, series.position, series.quaternion])
    for t, *place in rows.tolist():
        time = factory.time(t)
        point = factory.make("Point", x=place[0], y=place[1], z=place[2])
        turn = factory.make("Quaternion", x=place[3], y=place[4], z=place[5], w=place[6])
        pose = factory.make("Pose", position=point, orientation=turn)
        message = factory.make("PoseStamped", header=factory.header(time, BASE), pose=pose)
        yield time, f"/flange/{name}", "geometry_msgs/msg/PoseStamped", message


def _still_messages(session: Session, factory: MessageFactory) -> list[Message]:
    """Transforms and camera models that hold for the whole session."""
    frames, rig = session.frames, session.rig
    time = factory.time(float(min(frames.t_left[0], frames.t_right[0], session.encoders.t[0])))
    found: list[Message] = []
    transforms = []
    if rig.registered:
        transforms.append(factory.transform(RIG, BASE, np.asarray(rig.rig_T_base), time))
    sides = (("left", rig.left, frames.pan_left), ("right", rig.right, frames.pan_right))
    for name, camera, pan in sides:
        if np.ptp(pan) > TOL_STILL:
            continue
        pose = camera.rig_T_camera(float(pan[0]))
        transforms.append(factory.transform(RIG, f"{name}_optical", pose, time))
        message = _camera_info(camera, rig.image_size, factory, f"{name}_optical", time)
        found.append((time, f"/{name}/camera_info", "sensor_msgs/msg/CameraInfo", message))
    message = factory.make("TFMessage", transforms=transforms)
    return [(time, "/tf_static", "tf2_msgs/msg/TFMessage", message), *found]


def _camera_info(
    camera: Camera, size: tuple[int, int], factory: MessageFactory, frame: str, time: int
) -> Any:
    roi = factory.make(
        "RegionOfInterest", x_offset=0, y_offset=0, height=0, width=0, do_rectify=False
    )
    projection = np.column_stack([camera.matrix, np.zeros(3)])
    return factory.make(
        "CameraInfo", header=factory.header(time, frame), height=size[1], width=size[0],
        distortion_model="plumb_bob", d=np.asarray(camera.distortion, dtype=float),
        k=np.ravel(camera.matrix), r=np.ravel(np.eye(3)), p=np.ravel(projection),
        binning_x=0, binning_y=0, roi=roi,
    )  # fmt: skip


def _picture_messages(session: Session, side: int, factory: MessageFactory) -> Iterator[Message]:
    name = ("left", "right")[side]
    images = (session.left, session.right)[side]
    times = (session.frames.t_left, session.frames.t_right)[side].tolist()
    if images.lossy and isinstance(images, Video):  # JPEGs, as the camera gave them
        for t, data in zip(times, images.packets(), strict=False):
            time = factory.time(t)
            header = factory.header(time, f"{name}_optical")
            content = np.frombuffer(data, np.uint8)
            message = factory.make("CompressedImage", header=header, format="jpeg", data=content)
            yield time, f"/{name}/image_raw/compressed", "sensor_msgs/msg/CompressedImage", message
        return
    for t, image in zip(times, images.images(), strict=False):
        time = factory.time(t)
        message = _image(image, factory, factory.header(time, f"{name}_optical"))
        yield time, f"/{name}/image_raw", "sensor_msgs/msg/Image", message


def _image(image: Image, factory: MessageFactory, header: Any) -> Any:
    height, width = image.shape[:2]
    channels = 1 if image.ndim == 2 else image.shape[2]
    return factory.make(
        "Image", header=header, height=height, width=width,
        encoding="mono8" if channels == 1 else "bgr8", is_bigendian=0, step=width * channels,
        data=np.ascontiguousarray(image).reshape(-1),
    )  # fmt: skip
