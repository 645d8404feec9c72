"""MCAP files that are not of ROS 2's profile: Foxglove's schemas as JSON or protobuf, and ROS.

Foxglove's messages become those of ROS that say the same:

    foxglove.RawImage, CompressedImage            sensor_msgs Image, CompressedImage
    foxglove.CameraCalibration, JointStates       sensor_msgs CameraInfo, JointState
    foxglove.FrameTransform, FrameTransforms      tf2_msgs TFMessage

Source: Foxglove SDK, schemas (fields; base64 for bytes in JSON); MCAP format registry (encodings).
"""

import base64
import json
from collections.abc import Callable, Generator, Iterable
from contextlib import ExitStack
from dataclasses import dataclass, replace
from functools import cache, partial
from importlib import util
from pathlib import Path
from typing import Any

import numpy as np
from mcap.reader import make_reader
from mcap.records import Schema
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from verify.errors import InputError

ENCODINGS = ("json", "protobuf", "ros1", "cdr")
FOXGLOVE = "foxglove."  # before the names of its schemas
Undecoded = Callable[[], Any]
_TYPES = get_typestore(Stores.ROS2_HUMBLE).types


@dataclass(slots=True)
class McapConnection:
    """A channel: what a topic holds, and how many messages; the names are those of rosbags."""

    topic: str
    msgtype: str
    msgcount: int
    decode: Callable[[bytes], Any]


def has_own_encoding(path: Path) -> bool:
    """Whether an MCAP file is whole, not of ROS 2's profile, and holds what `McapReader` reads."""
    with path.open("rb") as file:
        try:
            reader = make_reader(file)
            profile, summary = reader.get_header().profile, reader.get_summary()
        except Exception:  # damaged bytes raise whatever the parser runs into: rosbags words it
            return False
    found = {channel.message_encoding for channel in summary.channels.values()} if summary else ()
    return profile != "ros2" and any(encoding in found for encoding in ENCODINGS)


class McapReader:
    """A file that is open; what `Bag` needs of rosbags' AnyReader.

    Raises:
        InputError: protobuf, and the package that reads it is not installed.
    """

    def __init__(self, path: Path) -> None:
        with ExitStack() as stack:
            self._reader = make_reader(stack.enter_context(path.open("rb")))
            summary = self._reader.get_summary()
            assert summary is not None  # has_own_encoding has read it
            statistics = summary.statistics
            counts = {} if statistics is None else statistics.channel_message_counts
            self._by_channel: dict[int, McapConnection] = {}
            for number, channel in summary.channels.items():
                schema = summary.schemas.get(channel.schema_id)
                decode, kind = _decoder(path, channel.message_encoding, schema)
                count = counts.get(number, 0)
                self._by_channel[number] = McapConnection(channel.topic, kind, count, decode)
            self._stack = stack.pop_all()

    @property
    def connections(self) -> list[McapConnection]:
        """All channels."""
        return list(self._by_channel.values())

    @property
    def topics(self) -> dict[str, McapConnection]:
        """Topics, of which several channels may be one."""
        found: dict[str, McapConnection] = {}
        for channel in self.connections:
            before = found[channel.topic].msgcount if channel.topic in found else 0
            found[channel.topic] = replace(channel, msgcount=before + channel.msgcount)
        return found

    def messages(
        self, connections: Iterable[McapConnection]
    ) -> Generator[tuple[McapConnection, int, Undecoded]]:
        """Stream messages, each with its channel and its time of recording, ns."""
        topics = [c.topic for c in connections]
        for _schema, channel, message in self._reader.iter_messages(topics):
            connection = self._by_channel[channel.id]
            yield connection, message.log_time, partial(connection.decode, message.data)

    def deserialize(self, message: Undecoded, _kind: str) -> Any:
        """Decode a message."""
        return message()

    def close(self) -> None:
        """Close the file."""
        self._stack.close()


def _decoder(
    path: Path, encoding: str, schema: Schema | None
) -> tuple[Callable[[bytes], Any], str]:
    """What makes a message of ROS of bytes, and its kind; other schemas keep their name."""
    name = "" if schema is None else schema.name
    if schema is not None and schema.encoding in ("ros1msg", "ros2msg"):
        kind = name.replace("/", "/msg/", 1) if "/msg/" not in name else name
        return partial(_decode_ros, kind, schema.data, encoding == "ros1"), kind
    kind, convert = _SCHEMAS.get(name.removeprefix(FOXGLOVE), (name, _unknown))
    if encoding == "json":
        return lambda raw: convert(json.loads(raw)), kind
    if encoding == "protobuf" and convert is not _unknown:
        if util.find_spec("mcap_protobuf") is None:
            found, remedy = "holds protobuf messages", "Run pip install 'verify-robot[protobuf]'."
            raise InputError(path, found, "the package mcap-protobuf-support reads them", remedy)
        from mcap_protobuf.decoder import DecoderFactory

        parse = DecoderFactory().decoder_for(encoding, schema)
        if parse is not None:
            return lambda raw: convert(parse(raw)), kind
    return _unknown, name


@cache
def _ros_types(kind: str, definition: bytes, ros1: bool) -> Any:
    """Types of ROS, with that of a kind, which may be a user's own."""
    store = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_HUMBLE)
    if kind not in store.types:
        store.register(get_types_from_msg(definition.decode(), kind))
    return store


def _decode_ros(kind: str, definition: bytes, ros1: bool, raw: bytes) -> Any:
    store = _ros_types(kind, definition, ros1)
    return store.deserialize_ros1(raw, kind) if ros1 else store.deserialize_cdr(raw, kind)


def _unknown(_message: Any) -> Any:
    raise ValueError("a schema that is not known")


def _get(message: Any, name: str, default: Any = None) -> Any:
    """A field of JSON or of protobuf."""
    if isinstance(message, dict):
        return message.get(name, default)
    return getattr(message, name, default)


def _bytes(message: Any) -> Any:
    data = _get(message, "data")
    data = base64.b64decode(data, validate=True) if isinstance(data, str) else data
    return np.frombuffer(data, np.uint8)


def _header(message: Any, frame: str = "frame_id") -> Any:
    stamp = _get(message, "timestamp")
    parts = [_get(stamp, a, _get(stamp, b, 0)) for a, b in (("sec", "seconds"), ("nsec", "nanos"))]
    time = _TYPES["builtin_interfaces/msg/Time"](*map(int, parts))
    return _TYPES["std_msgs/msg/Header"](stamp=time, frame_id=str(_get(message, frame, "")))


def _numbers(message: Any, name: str, count: int | None, default: Any = ()) -> Any:
    values = np.array(list(_get(message, name) or default), dtype=float)
    if count is not None and len(values) != count:
        raise ValueError(f"{name} of a CameraCalibration has {len(values)} numbers, not {count}")
    return values


def _image(message: Any) -> Any:
    width, height, step = (int(_get(message, name)) for name in ("width", "height", "step"))
    return _TYPES["sensor_msgs/msg/Image"](
        header=_header(message), width=width, height=height, step=step, is_bigendian=0,
        encoding=str(_get(message, "encoding")), data=_bytes(message),
    )  # fmt: skip


def _compressed(message: Any) -> Any:
    return _TYPES["sensor_msgs/msg/CompressedImage"](
        header=_header(message), format=str(_get(message, "format", "")), data=_bytes(message)
    )


def _calibration(message: Any) -> Any:
    roi = _TYPES["sensor_msgs/msg/RegionOfInterest"](0, 0, 0, 0, do_rectify=False)
    return _TYPES["sensor_msgs/msg/CameraInfo"](
        header=_header(message), width=int(_get(message, "width")),
        height=int(_get(message, "height")), roi=roi, binning_x=0, binning_y=0,
        distortion_model=str(_get(message, "distortion_model", "")),
        d=_numbers(message, "D", None), k=_numbers(message, "K", 9),
        r=_numbers(message, "R", 9, np.eye(3).ravel()), p=_numbers(message, "P", 12, np.zeros(12)),
    )  # fmt: skip


def _joints(message: Any) -> Any:
    """A JointState of the joints that have a position."""
    placed = [j for j in _get(message, "joints") if _has_position(j)]
    return _TYPES["sensor_msgs/msg/JointState"](
        header=_header(message), name=[str(_get(j, "name")) for j in placed],
        position=np.array([_get(j, "position") for j in placed], dtype=float),
        velocity=np.zeros(0), effort=np.zeros(0),
    )  # fmt: skip


def _has_position(joint: Any) -> bool:
    if isinstance(joint, dict):
        return joint.get("position") is not None
    field = joint.DESCRIPTOR.fields_by_name["position"]
    return not field.has_presence or bool(joint.HasField("position"))


def _transforms(message: Any) -> Any:
    listed = _get(message, "transforms")
    return _TYPES["tf2_msgs/msg/TFMessage"](
        transforms=[_transform(one) for one in ([message] if listed is None else listed)]
    )


def _transform(message: Any) -> Any:
    way, turn = _get(message, "translation"), _get(message, "rotation")
    x, y, z = (float(_get(way, axis, 0.0)) for axis in "xyz")
    made = _TYPES["geometry_msgs/msg/Transform"](
        translation=_TYPES["geometry_msgs/msg/Vector3"](x=x, y=y, z=z),
        rotation=_TYPES["geometry_msgs/msg/Quaternion"](
            **{axis: float(_get(turn, axis, 0.0)) for axis in "xyzw"}
        ),
    )
    return _TYPES["geometry_msgs/msg/TransformStamped"](
        header=_header(message, "parent_frame_id"), transform=made,
        child_frame_id=str(_get(message, "child_frame_id", "")),
    )  # fmt: skip


_SCHEMAS: dict[str, tuple[str, Callable[[Any], Any]]] = {
    "RawImage": ("sensor_msgs/msg/Image", _image),
    "CompressedImage": ("sensor_msgs/msg/CompressedImage", _compressed),
    "CameraCalibration": ("sensor_msgs/msg/CameraInfo", _calibration),
    "JointStates": ("sensor_msgs/msg/JointState", _joints),
    "FrameTransform": ("tf2_msgs/msg/TFMessage", _transforms),
    "FrameTransforms": ("tf2_msgs/msg/TFMessage", _transforms),
}
