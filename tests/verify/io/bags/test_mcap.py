"""MCAP files of no ROS 2 profile: Foxglove's schemas as JSON and protobuf, and ROS."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.support.command import Outcome, verify
from tests.support.foxglove import write_mcap
from tests.support.recorded import write_session
from verify.io.session.session import Recording, open_recording, open_session


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


@pytest.mark.parametrize("encoding", ["json", "protobuf", "ros1", "cdr"])
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
    assert "(cut off, or neither ROS nor JSON or protobuf)" in said
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
