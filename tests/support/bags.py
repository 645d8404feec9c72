"""Bags of a session's pictures and readings, written by rosbags."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from scipy.spatial.transform import Rotation

from verify.core.records import Array, Image
from verify.io.session.session import Recording

SECOND = 1_000_000_000
START = 1_780_000_000  # s since 1970
BAYER = {"rggb": (2, 1, 1, 0), "bggr": (0, 1, 1, 2), "gbrg": (1, 0, 2, 1), "grbg": (1, 2, 0, 1)}
KINDS = ("ros1", "sqlite3", "mcap")


class Messages:
    """Messages of one edition of ROS."""

    def __init__(self, kind: str) -> None:
        self.ros1 = kind == "ros1"
        self.store = get_typestore(Stores.ROS1_NOETIC if self.ros1 else Stores.ROS2_HUMBLE)
        if self.ros1:
            text = "geometry_msgs/TransformStamped[] transforms"
            self.store.register(get_types_from_msg(text, "tf2_msgs/msg/TFMessage"))

    def make(self, name: str, /, **fields: Any) -> Any:
        kind = next(k for k in self.store.types if k.endswith(f"/msg/{name}"))
        return self.store.types[kind](**fields)

    def header(self, t: float | None, frame: str = "") -> Any:
        ns = 0 if t is None else START * SECOND + round(t * SECOND)
        stamp = self.make("Time", sec=ns // SECOND, nanosec=ns % SECOND)
        more = {"seq": 0} if self.ros1 else {}
        return self.make("Header", stamp=stamp, frame_id=frame, **more)

    def image(self, t: float | None, samples: np.ndarray[Any, Any], encoding: str) -> Any:
        height, width = samples.shape[:2]
        data = np.ascontiguousarray(samples).view(np.uint8).reshape(-1)
        return self.make(
            "Image", header=self.header(t), height=height, width=width, encoding=encoding,
            is_bigendian=0, step=len(data) // height, data=data,
        )  # fmt: skip

    def compressed(self, t: float | None, data: bytes, form: str) -> Any:
        content = np.frombuffer(data, np.uint8)
        return self.make("CompressedImage", header=self.header(t), format=form, data=content)

    def joints(self, t: float | None, names: Sequence[str], q: Array) -> Any:
        none = np.zeros(0)
        return self.make(
            "JointState", header=self.header(t), name=list(names), position=np.asarray(q),
            velocity=none, effort=none,
        )  # fmt: skip

    def camera_info(self, camera: Any, size: tuple[int, int], frame: str, tx: float = 0.0) -> Any:
        values = {
            "d": np.asarray(camera.distortion, float), "k": np.ravel(camera.matrix),
            "r": np.ravel(np.eye(3)),
            "p": np.ravel(np.column_stack([camera.matrix, [tx * camera.matrix[0, 0], 0, 0]])),
        }  # fmt: skip
        if self.ros1:
            values = {key.upper(): value for key, value in values.items()}
        roi = self.make(
            "RegionOfInterest", x_offset=0, y_offset=0, height=0, width=0, do_rectify=False
        )
        return self.make(
            "CameraInfo", header=self.header(0.0, frame), height=size[1], width=size[0],
            distortion_model="plumb_bob", binning_x=0, binning_y=0, roi=roi, **values,
        )  # fmt: skip

    def static(self, transforms: dict[tuple[str, str], Array]) -> Any:
        made = []
        for (parent, child), pose in transforms.items():
            x, y, z, w = Rotation.from_matrix(pose[:3, :3]).as_quat().tolist()
            way = self.make("Vector3", x=pose[0, 3], y=pose[1, 3], z=pose[2, 3])
            turn = self.make("Quaternion", x=x, y=y, z=z, w=w)
            inner = self.make("Transform", translation=way, rotation=turn)
            header = self.header(0.0, parent)
            made.append(
                self.make("TransformStamped", header=header, child_frame_id=child, transform=inner)
            )
        return self.make("TFMessage", transforms=made)


@dataclass
class Contents:
    """What goes into a bag: messages by topic, each with the time at which it arrives."""

    kind: str
    messages: Messages = field(init=False)
    topics: dict[str, tuple[str, list[tuple[float, Any]]]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.messages = Messages(self.kind)

    def add(self, topic: str, rows: Iterable[tuple[float, Any]], kind: str = "") -> None:
        listed = list(rows)
        self.topics[topic] = (kind or listed[0][1].__msgtype__, listed)


def write_bag(path: Path, contents: Contents) -> Path:
    """Write a bag by rosbags' own writers; its path."""
    store = contents.messages.store
    writer: Any
    if contents.kind == "ros1":
        path = path.with_suffix(".bag")
        writer, serialize = Writer1(path), store.serialize_ros1
    else:
        plugin = StoragePlugin.MCAP if contents.kind == "mcap" else StoragePlugin.SQLITE3
        writer, serialize = Writer2(path, version=9, storage_plugin=plugin), store.serialize_cdr
    with writer:
        connections = {
            topic: writer.add_connection(topic, kind, typestore=store)
            for topic, (kind, _) in contents.topics.items()
        }
        rows = [
            (t, topic, message)
            for topic, (_, messages) in contents.topics.items()
            for t, message in messages
        ]
        for t, topic, message in sorted(rows, key=lambda row: row[0]):
            data = serialize(message, message.__msgtype__)
            writer.write(connections[topic], START * SECOND + round(t * SECOND), data)
    return path


def mosaic(image: Image, order: str) -> Image:
    """What a colour filter leaves of a picture (h, w) or (h, w, 3) BGR."""
    if image.ndim == 2:
        return image
    found = np.zeros(image.shape[:2], np.uint8)
    for place, channel in enumerate(BAYER[order]):
        rows, columns = divmod(place, 2)
        found[rows::2, columns::2] = image[rows::2, columns::2, channel]
    return found


def encode(m: Messages, t: float | None, image: Image, encoding: str) -> Any:
    """A picture (h, w) or (h, w, 3) BGR as a message of an encoding."""
    if encoding in ("jpeg", "png"):
        options = [cv2.IMWRITE_JPEG_QUALITY, 95] if encoding == "jpeg" else []
        return m.compressed(t, cv2.imencode(f".{encoding}", image, options)[1].tobytes(), encoding)
    if encoding.startswith("bayer"):
        return m.image(t, mosaic(image, encoding[6:10]), encoding)
    if encoding == "mono16":
        return m.image(t, image.astype(np.uint16) * 16, encoding)  # 12 bits
    if encoding == "rgb8":
        return m.image(t, image[..., ::-1], encoding)
    if encoding == "bgr8" and image.ndim == 2:
        return m.image(t, np.repeat(image[..., None], 3, axis=2), encoding)
    return m.image(t, image, encoding)


def bag_of(
    kind: str,
    session: Recording,
    encoding: str = "mono8",
    names: Sequence[str] = (),
    change: Callable[[Contents], None] = lambda _: None,
) -> Contents:
    """A session's pictures and readings as a bag; the joints in another order in every message."""
    contents = Contents(kind)
    m, rng = contents.messages, np.random.default_rng(7)
    names = names or [f"joint_{j}" for j in range(1, session.arm.dof + 1)]
    sides = (("left", session.left, session.frames.t_left, session.rig.left),
             ("right", session.right, session.frames.t_right, session.rig.right))  # fmt: skip
    transforms = {}
    for side, images, times, camera in sides:
        t = times.tolist()
        contents.add(
            f"/{side}/image_raw" + "/compressed" * (encoding in ("jpeg", "png")),
            [
                (a + 0.01, encode(m, a, i, encoding))
                for a, i in zip(t, images.images(), strict=True)
            ],
        )
        info = m.camera_info(camera, session.rig.image_size, f"{side}_optical")
        contents.add(f"/{side}/camera_info", [(0.0, info)])
        transforms["mount", f"{side}_optical"] = np.asarray(camera.rig_T_camera(camera.pan))
    contents.add("/tf_static", [(0.0, m.static(transforms))])
    rows = []
    for t, q in zip(session.encoders.t.tolist(), session.encoders.q, strict=True):
        order = rng.permutation(len(names))
        rows.append((t + 0.001, m.joints(t, [names[i] for i in order], q[order])))
    contents.add("/joint_states", rows)
    change(contents)
    return contents
