"""MCAP files without ROS 2: Foxglove's schemas as JSON and protobuf, and ROS 1."""

import base64
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from mcap.writer import Writer
from mcap_protobuf.schema import build_file_descriptor_set

from tests.support.bags import START, bag_of
from tests.support.command import Outcome, verify
from tests.support.recorded import write_session
from verify.io.session.session import Recording, open_recording, open_session

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
    contents = bag_of("ros1" if encoding == "ros1" else "mcap", recording, pictures)
    classes = protobuf_classes()
    store = contents.messages.store
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start(profile="ros1" if encoding == "ros1" else "")
        for topic, (kind, rows) in contents.topics.items():
            name = kind.rsplit("/", 1)[1]
            if encoding == "ros1":
                definition = store.generate_msgdef(kind, ros_version=1)[0]
                ros_name = kind.replace("/msg/", "/")
                schema = writer.register_schema(ros_name, "ros1msg", definition.encode())
            elif encoding == "json":
                schema = writer.register_schema(f"foxglove.{TYPES[name]}", "jsonschema", b"{}")
            else:
                described = build_file_descriptor_set(classes[TYPES[name]]).SerializeToString()
                schema = writer.register_schema(f"foxglove.{TYPES[name]}", "protobuf", described)
            channel = writer.register_channel(topic, encoding, schema)
            for t, message in rows:
                time = START * 10**9 + round(t * 1e9)
                fields = {} if encoding == "ros1" else fields_of(message)
                change(fields)
                if encoding == "ros1":
                    data = bytes(store.serialize_ros1(message, message.__msgtype__))
                elif encoding == "json":
                    data = json.dumps(to_json(fields)).encode()
                else:
                    made = classes[TYPES[name]](**to_protobuf(fields))
                    data = made.SerializeToString()
                writer.add_message(channel, time, data, time)
        writer.finish()
    return path


def left_T_right(recording: Recording) -> Any:
    left, right = (
        side.rig_T_camera(side.pan) for side in (recording.rig.left, recording.rig.right)
    )
    return np.linalg.inv(left) @ right


def convert(bag: Path, out: Path, *options: str | Path) -> Outcome:
    return verify("convert", bag, "-o", out, "--robot", "iust_6r", *options)


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    return open_session(write_session(tmp_path_factory.mktemp("mcap") / "session"))


@pytest.mark.parametrize("encoding", ["json", "protobuf", "ros1"])
def test_pictures_times_readings_and_cameras_survive(
    encoding: str, session: Recording, tmp_path: Path
) -> None:
    done = convert(write_mcap(tmp_path / "a.mcap", session, encoding), tmp_path / "out")
    assert done.status == 0, done.err
    found = open_recording(tmp_path / "out")
    np.testing.assert_allclose(found.frames.t_left, session.frames.t_left, rtol=0, atol=1e-9)
    np.testing.assert_allclose(found.frames.t_right, session.frames.t_right, rtol=0, atol=1e-9)
    np.testing.assert_allclose(found.encoders.t, session.encoders.t, rtol=0, atol=1e-9)
    np.testing.assert_allclose(found.encoders.q, session.encoders.q, rtol=0, atol=1e-11)
    for side in ("left", "right"):
        kept, given = getattr(found, side).images(), getattr(session, side).images()
        assert all(map(np.array_equal, kept, given))
        cameras = [getattr(one.rig, side) for one in (found, session)]
        np.testing.assert_array_equal(cameras[0].matrix, cameras[1].matrix)
        np.testing.assert_array_equal(cameras[0].distortion, cameras[1].distortion)
    np.testing.assert_allclose(left_T_right(found), left_T_right(session), rtol=0, atol=1e-12)


@pytest.mark.parametrize("encoding", ["json", "protobuf"])
def test_jpegs_stay_as_they_are(encoding: str, session: Recording, tmp_path: Path) -> None:
    bag = write_mcap(tmp_path / "a.mcap", session, encoding, "jpeg")
    assert convert(bag, tmp_path / "out").status == 0
    assert open_recording(tmp_path / "out").left.lossy


def test_a_file_that_was_cut_off_is_refused(session: Recording, tmp_path: Path) -> None:
    bag = write_mcap(tmp_path / "a.mcap", session, "json")
    bag.write_bytes(bag.read_bytes()[:-200])
    said = convert(bag, tmp_path / "out").refusal
    assert "`mcap recover`" in said
    assert not (tmp_path / "out").exists()


def drop_position(fields: dict[str, Any]) -> None:
    for joint in fields.get("joints", []):
        if joint["name"] == "joint_3":
            del joint["position"]


def fisheye(fields: dict[str, Any]) -> None:
    if "distortion_model" in fields:
        fields |= {"distortion_model": "kannala_brandt", "D": [0.1, 0.2, 0.3, 0.4]}


def short_matrix(fields: dict[str, Any]) -> None:
    if "K" in fields:
        fields["K"] = [1.0, 2.0]


def half_picture(fields: dict[str, Any]) -> None:
    if "data" in fields:
        fields["data"] = fields["data"][:50]


@pytest.mark.parametrize("encoding", ["json", "protobuf"])
@pytest.mark.parametrize(
    ("change", "words"),
    [
        (drop_position, "/joint_states: has the joints joint_1, joint_2, joint_4"),
        (fisheye, 'has a lens of the model "kannala_brandt"'),
        (short_matrix, "K of a CameraCalibration has 2 numbers, not 9"),
        (half_picture, "has 50 bytes for"),
    ],
)
def test_what_a_message_lacks_is_said_in_one_line(
    encoding: str, change: Callable[[dict[str, Any]], None], words: str, session: Recording,
    tmp_path: Path,
) -> None:  # fmt: skip
    bag = write_mcap(tmp_path / "a.mcap", session, encoding, change=change)
    assert words in convert(bag, tmp_path / "out").refusal
    assert not (tmp_path / "out").exists()


def test_a_missing_package_is_named(
    session: Recording, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    bag = write_mcap(tmp_path / "a.mcap", session, "protobuf")
    monkeypatch.setattr("verify.io.bags.mcap.util.find_spec", lambda _: None)
    assert "pip install 'verify-robot[protobuf]'" in convert(bag, tmp_path / "out").refusal
