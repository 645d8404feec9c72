"""MCAP files of no ROS 2 profile, written by the package mcap: Foxglove's schemas, and ROS."""

import base64
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from mcap.writer import Writer
from mcap_protobuf.schema import build_file_descriptor_set

from tests.support.bags import START, bag_of
from verify.io.session.session import Recording

FIELD = descriptor_pb2.FieldDescriptorProto
KINDS = {  # of a field in a protobuf schema
    "string": FIELD.TYPE_STRING, "bytes": FIELD.TYPE_BYTES, "double": FIELD.TYPE_DOUBLE,
    "fixed32": FIELD.TYPE_FIXED32,
}  # fmt: skip
SCHEMAS = {  # the fields of Foxglove's schemas that are read: name, type, repeated
    "JointState": ["name:string", "position:double?"],
    "JointStates": ["timestamp:Timestamp", "joints:JointState*"],
    "CompressedImage": ["timestamp:Timestamp", "frame_id:string", "data:bytes", "format:string"],
    "RawImage": ["timestamp:Timestamp", "frame_id:string", "width:fixed32", "height:fixed32",
                 "encoding:string", "step:fixed32", "data:bytes"],
    "CameraCalibration": ["timestamp:Timestamp", "frame_id:string", "width:fixed32",
                          "height:fixed32", "distortion_model:string", "D:double*", "K:double*",
                          "R:double*", "P:double*"],
    "Vector3": ["x:double", "y:double", "z:double"],
    "Quaternion": ["x:double", "y:double", "z:double", "w:double"],
    "FrameTransform": ["timestamp:Timestamp", "parent_frame_id:string", "child_frame_id:string",
                       "translation:Vector3", "rotation:Quaternion"],
    "FrameTransforms": ["transforms:FrameTransform*"],
}  # fmt: skip
TYPES = {
    "Image": "RawImage", "CompressedImage": "CompressedImage", "CameraInfo": "CameraCalibration",
    "JointState": "JointStates", "TFMessage": "FrameTransforms",
}  # fmt: skip


def protobuf_classes() -> dict[str, Any]:
    """Message classes of the schemas above, made by protobuf itself."""
    file = descriptor_pb2.FileDescriptorProto(name="foxglove.proto", package="foxglove")
    file.syntax = "proto3"
    pool = descriptor_pool.DescriptorPool()
    stamp = descriptor_pb2.FileDescriptorProto(
        name="google/protobuf/timestamp.proto", package="google.protobuf", syntax="proto3"
    )
    made = stamp.message_type.add(name="Timestamp")
    made.field.add(name="seconds", number=1, type=FIELD.TYPE_INT64, label=FIELD.LABEL_OPTIONAL)
    made.field.add(name="nanos", number=2, type=FIELD.TYPE_INT32, label=FIELD.LABEL_OPTIONAL)
    pool.Add(stamp)
    file.dependency.append(stamp.name)
    for name, fields in SCHEMAS.items():
        message = file.message_type.add(name=name)
        for number, text in enumerate(fields, start=1):
            key, kind = text.split(":")
            label = FIELD.LABEL_REPEATED if kind.endswith("*") else FIELD.LABEL_OPTIONAL
            field = message.field.add(name=key, number=number, label=label)
            if kind.endswith("?"):
                field.proto3_optional, field.oneof_index = True, len(message.oneof_decl)
                message.oneof_decl.add(name=f"_{key}")
            kind = kind.rstrip("*?")
            if kind in KINDS:
                field.type = KINDS[kind]
            else:
                field.type = FIELD.TYPE_MESSAGE
                package = "google.protobuf" if kind == "Timestamp" else "foxglove"
                field.type_name = f".{package}.{kind}"
    pool.Add(file)
    names = {name: pool.FindMessageTypeByName(f"foxglove.{name}") for name in SCHEMAS}
    return {name: message_factory.GetMessageClass(found) for name, found in names.items()}


def fields_of(message: Any) -> dict[str, Any]:
    """What a ROS message says, by the fields of Foxglove's schema; bytes as they are."""
    kind = message.__msgtype__.rsplit("/", 1)[1]
    if kind == "TFMessage":
        return {"transforms": [fields_of(one) for one in message.transforms]}
    stamp = {"sec": message.header.stamp.sec, "nsec": message.header.stamp.nanosec}
    found = {"timestamp": stamp, "frame_id": message.header.frame_id}
    if kind == "TransformStamped":
        way, turn = message.transform.translation, message.transform.rotation
        del found["frame_id"]
        return found | {
            "parent_frame_id": message.header.frame_id, "child_frame_id": message.child_frame_id,
            "translation": {axis: getattr(way, axis) for axis in "xyz"},
            "rotation": {axis: getattr(turn, axis) for axis in "xyzw"},
        }  # fmt: skip
    if kind == "JointState":
        pairs = zip(message.name, message.position.tolist(), strict=True)
        joints = [*({"name": n, "position": q} for n, q in pairs), {"name": "lamp"}]
        return {"timestamp": stamp, "joints": joints}
    if kind == "CameraInfo":
        numbers = {key: getattr(message, key.lower()).tolist() for key in "DKRP"}
        size = {"width": message.width, "height": message.height}
        return found | numbers | size | {"distortion_model": message.distortion_model}
    keys = ("format",) if kind == "CompressedImage" else ("width", "height", "step", "encoding")
    return found | {key: getattr(message, key) for key in keys} | {"data": message.data.tobytes()}


def to_json(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: to_json(one) for key, one in value.items()}
    if isinstance(value, list):
        return [to_json(one) for one in value]
    return base64.b64encode(value).decode() if isinstance(value, bytes) else value


def to_protobuf(value: Any) -> Any:
    if isinstance(value, dict):
        names = {"sec": "seconds", "nsec": "nanos"}
        return {names.get(key, key): to_protobuf(one) for key, one in value.items()}
    return [to_protobuf(one) for one in value] if isinstance(value, list) else value


def write_mcap(
    path: Path,
    recording: Recording,
    encoding: str,
    pictures: str = "mono8",
    change: Callable[[dict[str, Any]], None] = lambda _: None,
) -> Path:
    """Write a session's pictures and readings by the writer of the package mcap.

    `change` changes the fields of every message of Foxglove's schemas.
    """
    ros1, of_ros = encoding == "ros1", encoding in ("ros1", "cdr")
    contents = bag_of("ros1" if ros1 else "mcap", recording, pictures)
    classes = protobuf_classes()
    store = contents.messages.store
    serialize = store.serialize_ros1 if ros1 else store.serialize_cdr
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start(profile="ros1" if ros1 else "")
        for topic, (kind, rows) in contents.topics.items():
            name = kind.rsplit("/", 1)[1]
            if of_ros:
                definition = store.generate_msgdef(kind, ros_version=1 if ros1 else 2)[0]
                ros_name = kind.replace("/msg/", "/") if ros1 else kind
                form = "ros1msg" if ros1 else "ros2msg"
                schema = writer.register_schema(ros_name, form, definition.encode())
            elif encoding == "json":
                schema = writer.register_schema(f"foxglove.{TYPES[name]}", "jsonschema", b"{}")
            else:
                described = build_file_descriptor_set(classes[TYPES[name]]).SerializeToString()
                schema = writer.register_schema(f"foxglove.{TYPES[name]}", "protobuf", described)
            channel = writer.register_channel(topic, encoding, schema)
            for t, message in rows:
                time = START * 10**9 + round(t * 1e9)
                fields = {} if of_ros else fields_of(message)
                change(fields)
                if of_ros:
                    data = bytes(serialize(message, message.__msgtype__))
                elif encoding == "json":
                    data = json.dumps(to_json(fields)).encode()
                else:
                    data = classes[TYPES[name]](**to_protobuf(fields)).SerializeToString()
                writer.add_message(channel, time, data, time)
        writer.finish()
    return path
