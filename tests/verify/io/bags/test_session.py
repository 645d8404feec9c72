"""Bags that rosbags writes become the sessions that they were made from."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from tests.support.bags import KINDS, Contents, bag_of, write_bag
from tests.support.command import SAMPLES, Outcome, sample_results, verify
from tests.support.recorded import images, write_session, write_video
from verify.analysis.session import analyse
from verify.core.records import Array, Image
from verify.io.bags.session import pair_stamps
from verify.io.session.session import Recording, open_recording, open_session

UR_NAMES = ("elbow", "lift", "pan", "wrist_1", "wrist_2", "wrist_3")  # no numbers to go by


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    return open_session(write_session(tmp_path_factory.mktemp("small") / "session"))


@pytest.fixture(scope="module")
def colour(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    """Coloured pictures, evenly so over patches of 16 px."""
    folder = write_session(tmp_path_factory.mktemp("colour") / "session")
    for side, seed in (("left", 1), ("right", 2)):
        patches = np.random.default_rng(seed).integers(0, 255, (6, 3, 4, 3), dtype=np.uint8)
        write_video(folder / f"{side}.mkv", list(patches.repeat(16, axis=1).repeat(16, axis=2)))
    return open_session(folder)


def convert(bag: Path, out: Path, *options: str | Path) -> Outcome:
    return verify("convert", bag, "-o", out, "--robot", "iust_6r", *options)


def convert_contents(tmp_path: Path, contents: Contents, *options: str | Path) -> Recording:
    done = convert(write_bag(tmp_path / "bag", contents), tmp_path / "out", *options)
    assert done.status == 0, done.err
    return open_recording(tmp_path / "out")


def refusal(tmp_path: Path, contents: Contents, *options: str | Path) -> str:
    """The one line; nothing is left behind."""
    said = convert(write_bag(tmp_path / "bag", contents), tmp_path / "out", *options).refusal
    assert [p.name for p in tmp_path.iterdir() if p.stem != "bag"] == []
    return said


def left_T_right(recording: Recording) -> Array:
    rig, frames = recording.rig, recording.frames
    left, right = (
        camera.rig_T_camera(float(pan[0]))
        for camera, pan in ((rig.left, frames.pan_left), (rig.right, frames.pan_right))
    )
    return np.asarray(np.linalg.inv(left) @ right)


def pictures(recording: Recording) -> list[Image]:
    return [*recording.left.images(), *recording.right.images()]


@pytest.mark.parametrize("kind", KINDS)
def test_pictures_times_readings_and_cameras_survive(
    kind: str, session: Recording, tmp_path: Path
) -> None:
    found = convert_contents(tmp_path, bag_of(kind, session))
    assert found.started == "2026-05-28T20:26:40Z"  # the first stamp: 1,780,000,000 s
    for kept, given in (
        (found.frames.t_left, session.frames.t_left),
        (found.frames.t_right, session.frames.t_right),
        (found.encoders.t, session.encoders.t),
    ):
        np.testing.assert_allclose(kept, given, rtol=0, atol=1e-9)
    np.testing.assert_allclose(found.encoders.q, session.encoders.q, rtol=0, atol=1e-11)
    assert all(map(np.array_equal, pictures(found), pictures(session)))
    np.testing.assert_allclose(left_T_right(found), left_T_right(session), rtol=0, atol=1e-12)
    np.testing.assert_array_equal(found.rig.left.distortion, session.rig.left.distortion)
    assert not found.rig.registered
    assert not found.left.lossy


@pytest.mark.parametrize("suffix", [".mcap", ".db3"])
def test_a_file_alone_is_read_without_its_metadata(
    suffix: str, session: Recording, tmp_path: Path
) -> None:
    kind = "mcap" if suffix == ".mcap" else "sqlite3"
    (file,) = write_bag(tmp_path / "bag", bag_of(kind, session)).glob(f"*{suffix}")
    assert convert(file, tmp_path / "out").status == 0
    assert len(open_recording(tmp_path / "out")) == len(session)


@pytest.mark.parametrize("encoding", ["png", "mono16", "bgr8"])
def test_grey_encodings_lose_nothing(encoding: str, session: Recording, tmp_path: Path) -> None:
    found = pictures(convert_contents(tmp_path, bag_of("mcap", session, encoding)))
    for kept, given in zip(found, pictures(session), strict=True):
        shown = kept[..., 0] if kept.ndim == 3 else kept
        np.testing.assert_array_equal(shown, given)


@pytest.mark.parametrize("order", ["rggb", "bggr", "gbrg", "grbg"])
def test_colours_come_through_a_bayer_filter_in_their_order(
    order: str, colour: Recording, tmp_path: Path
) -> None:
    found = pictures(convert_contents(tmp_path, bag_of("mcap", colour, f"bayer_{order}8")))
    for kept, given in zip(found, pictures(colour), strict=True):
        np.testing.assert_array_equal(kept[8::16, 8::16], given[8::16, 8::16])


def test_red_and_blue_are_not_exchanged(colour: Recording, tmp_path: Path) -> None:
    found = pictures(convert_contents(tmp_path, bag_of("mcap", colour, "rgb8")))
    assert all(map(np.array_equal, found, pictures(colour)))


def test_a_jpeg_stays_as_the_camera_made_it_and_is_known_as_lossy(
    session: Recording, tmp_path: Path
) -> None:
    found = convert_contents(tmp_path, bag_of("mcap", session, "jpeg"))
    assert found.left.lossy
    encoded = [
        cv2.imencode(".jpeg", image, [cv2.IMWRITE_JPEG_QUALITY, 95])[1].tobytes()
        for image in images()
    ]
    assert list(found.left.packets()) == encoded  # type: ignore[attr-defined]  # a video


def test_pictures_apart_keep_their_own_stamps_and_one_without_a_partner_is_left_out(
    session: Recording, tmp_path: Path
) -> None:
    def drop(contents: Contents) -> None:
        del contents.topics["/right/image_raw"][1][2]

    found = convert_contents(tmp_path, bag_of("mcap", session, change=drop))
    kept = [0, 1, 3, 4, 5]
    np.testing.assert_allclose(found.frames.t_right, session.frames.t_right[kept], atol=1e-9)
    expected = [images()[i] for i in kept]
    assert all(map(np.array_equal, found.left.images(), expected))


def test_pictures_are_paired_with_their_nearest_and_never_twice() -> None:
    left = np.array([0, 100, 200, 300, 300, 400], np.int64)
    right = np.array([-40, 90, 210, 251, 390], np.int64)
    assert pair_stamps(left, right).tolist() == [[0, 0], [1, 1], [2, 2], [3, 3], [5, 4]]


def test_names_without_numbers_are_asked_for_and_taken(session: Recording, tmp_path: Path) -> None:
    contents = bag_of("mcap", session, names=UR_NAMES)
    said = refusal(tmp_path, contents)
    assert "elbow" in said
    assert "--joint-names" in said
    order = ("--joint-names", ",".join(UR_NAMES))
    done = convert(tmp_path / "bag", tmp_path / "out", *order)
    assert done.status == 0
    np.testing.assert_allclose(
        open_recording(tmp_path / "out").encoders.q, session.encoders.q, atol=1e-11
    )


def test_joints_of_a_gripper_between_are_left_alone(session: Recording, tmp_path: Path) -> None:
    def add(contents: Contents) -> None:
        kind, rows = contents.topics["/joint_states"]
        gripper = [(0.002, contents.messages.joints(0.001, ["finger_1"], np.array([9.0])))]
        contents.topics["/joint_states"] = (kind, [*gripper, *rows])

    found = convert_contents(tmp_path, bag_of("ros1", session, change=add))
    assert len(found.encoders) == len(session.encoders)


def test_two_arms_on_one_topic_are_not_guessed_between(session: Recording, tmp_path: Path) -> None:
    def add(contents: Contents) -> None:
        kind, rows = contents.topics["/joint_states"]
        names = [f"robot2/joint_{j}" for j in range(1, 7)]
        other = [(t, contents.messages.joints(t, names, np.ones(6))) for t, _ in rows]
        contents.topics["/joint_states"] = kind, [*rows, *other]

    first, second = ([f"robot{k}/joint_{j}" for j in range(1, 7)] for k in (1, 2))
    contents = bag_of("mcap", session, names=first, change=add)
    said = refusal(tmp_path, contents)
    assert "has the joints of robot1/joint_1" in said
    assert ", robot2/joint_6; one arm" in said
    bag = tmp_path / "bag"
    done = convert(bag, tmp_path / "out", "--joint-names", ",".join(first))
    assert done.status == 0, done.err
    found = open_recording(tmp_path / "out").encoders
    np.testing.assert_allclose(found.q, session.encoders.q, rtol=0, atol=1e-11)
    said = convert(bag, tmp_path / "other", "--joint-names", ",".join(second)).out
    assert "robot2/joint_1 → q1" in said


def test_a_second_publisher_of_the_same_joints_is_noticed(
    session: Recording, tmp_path: Path
) -> None:
    def add(contents: Contents) -> None:
        kind, rows = contents.topics["/joint_states"]
        names = [f"joint_{j}" for j in range(1, 7)]  # all at 0: joint_state_publisher's
        zeros = [(t + 5e-4, contents.messages.joints(t, names, np.zeros(6))) for t, _ in rows]
        contents.topics["/joint_states"] = kind, [*rows, *zeros]

    said = refusal(tmp_path, bag_of("mcap", session, change=add))
    assert "readings leap from the one before as no arm turns; one publisher" in said


def test_the_right_camera_is_placed_by_its_projection_without_tf(
    session: Recording, tmp_path: Path
) -> None:
    def parallel(contents: Contents) -> None:
        del contents.topics["/tf_static"]
        info = contents.messages.camera_info(
            session.rig.right, session.rig.image_size, "right_optical", tx=-0.12
        )
        contents.add("/right/camera_info", [(0.0, info)])

    found = left_T_right(convert_contents(tmp_path, bag_of("mcap", session, change=parallel)))
    expected = np.eye(4)
    expected[0, 3] = 0.12
    np.testing.assert_allclose(found, expected, atol=1e-12)


def test_rectified_pictures_are_taken_whatever_lens_they_came_through(
    session: Recording, tmp_path: Path
) -> None:
    def rectify(contents: Contents) -> None:
        for side in ("left", "right"):
            name = f"/{side}/image_raw"
            contents.topics[f"/{side}/image_rect"] = contents.topics.pop(name)
            info = contents.topics[f"/{side}/camera_info"][1][0][1]
            info.distortion_model, info.d = "equidistant", np.array([0.1, 0.02, 0.003, 0.001])

    rig = convert_contents(tmp_path, bag_of("mcap", session, change=rectify)).rig
    for camera, given in ((rig.left, session.rig.left), (rig.right, session.rig.right)):
        np.testing.assert_allclose(camera.matrix, given.matrix)
        assert not camera.distortion.any()


def drop_stamps(contents: Contents) -> None:
    for _, message in contents.topics["/left/image_raw"][1][2:4]:
        message.header.stamp.sec = message.header.stamp.nanosec = 0


def empty_joints(contents: Contents) -> None:
    contents.topics["/joint_states"] = ("sensor_msgs/msg/JointState", [])


def in_degrees(contents: Contents) -> None:
    for _, message in contents.topics["/joint_states"][1]:
        message.position[:] = np.rad2deg(message.position)


def no_tf(contents: Contents) -> None:
    del contents.topics["/tf_static"]


def no_camera_info(contents: Contents) -> None:
    del contents.topics["/left/camera_info"]


def other_names(contents: Contents) -> None:
    for old, new in (("/left/image_raw", "/a/image"), ("/right/image_raw", "/b/image")):
        contents.topics[new] = contents.topics.pop(old)


def two_left(contents: Contents) -> None:
    contents.topics["/left/image_mono"] = contents.topics["/left/image_raw"]


def odd_encoding(contents: Contents) -> None:
    for _, message in contents.topics["/left/image_raw"][1]:
        message.encoding = "32FC1"


def short_picture(contents: Contents) -> None:
    message = contents.topics["/right/image_raw"][1][3][1]
    message.data = message.data[:-5]


def far_apart(contents: Contents) -> None:
    for _, message in contents.topics["/right/image_raw"][1]:
        message.header.stamp.sec += 3600


def fisheye(contents: Contents) -> None:
    contents.topics["/left/camera_info"][1][0][1].distortion_model = "equidistant"


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (drop_stamps, ("/left/image_raw", "2 of 6 messages have no stamp", "--stamps received")),
        (empty_joints, ("/joint_states", "has no messages")),
        (in_degrees, ("in rad runs from", "--angles deg")),
        (no_tf, ("does not say where the cameras stand", "--rig")),
        (no_camera_info, ("/left/image_raw", "has no camera model", "--rig")),
        (other_names, ('no picture topic with "left"', "/a/image, /b/image", "--left TOPIC")),
        (two_left, ("/left/image_mono", "/left/image_raw", "--left TOPIC")),
        (odd_encoding, ("message 0", '"32FC1"', "mono8")),
        (short_picture, ("/right/image_raw, message 3", "bytes for 64 x 48 px")),
        (far_apart, ("0 pictures of one moment",)),
        (fisheye, ("/left/camera_info", '"equidistant"', "--rig")),
    ],
)
def test_what_a_bag_lacks_is_said_in_one_line(
    change: Callable[[Contents], None], words: tuple[str, ...], session: Recording, tmp_path: Path
) -> None:
    said = refusal(tmp_path, bag_of("mcap", session, change=change))
    assert [word for word in words if word not in said] == [], said


def test_times_of_recording_serve_where_there_are_no_stamps(
    session: Recording, tmp_path: Path
) -> None:
    contents = bag_of("mcap", session, change=drop_stamps)
    found = convert_contents(tmp_path, contents, "--stamps", "received")
    np.testing.assert_allclose(found.frames.t_left, session.frames.t_left + 0.01, atol=1e-9)


def test_degrees_are_taken_where_they_are_stated(session: Recording, tmp_path: Path) -> None:
    contents = bag_of("mcap", session, change=in_degrees)
    found = convert_contents(tmp_path, contents, "--angles", "deg")
    np.testing.assert_allclose(found.encoders.q, session.encoders.q, atol=1e-11)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("share", [0.6, 0.999])
def test_a_bag_that_was_cut_off_is_refused_in_one_line(
    kind: str, share: float, session: Recording, tmp_path: Path
) -> None:
    bag = write_bag(tmp_path / "bag", bag_of(kind, session))
    file = bag if bag.is_file() else next(f for f in bag.iterdir() if f.suffix != ".yaml")
    data = file.read_bytes()
    file.write_bytes(data[: int(share * len(data))])
    said = convert(bag, tmp_path / "out").refusal
    assert str(bag) in said
    assert not (tmp_path / "out").exists()


def test_the_robot_of_an_existing_session_serves_and_its_files_stay(
    session: Recording, tmp_path: Path
) -> None:
    bag = write_bag(tmp_path / "bag", bag_of("mcap", session))
    assert "--robot" in verify("convert", bag, "-o", tmp_path / "out").refusal
    folder = write_session(tmp_path / "out")
    assert "is not empty" in verify("convert", bag, "-o", folder).refusal
    assert verify("convert", bag, "-o", folder, "--force").status == 0
    assert (folder / "marker.toml").is_file()


def differences(first: dict[str, Any], second: dict[str, Any], key: str) -> Array:
    pairs = zip(first["joints"], second["joints"], strict=True)
    return np.array([a[key] - b[key] for a, b in pairs])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "encoding"), [("ros1", "mono16"), ("sqlite3", "bayer_rggb8"), ("mcap", "jpeg")]
)
def test_a_converted_session_gives_the_same_errors(
    kind: str, encoding: str, tmp_path: Path
) -> None:
    """Lossless: the same figures; a JPEG or interpolated colours: within the uncertainty."""
    sample = SAMPLES / "multi_joint_fault_6r"
    bag = write_bag(tmp_path / "bag", bag_of(kind, open_session(sample), encoding))
    files = ("--rig", sample / "rig.toml", "--marker", sample / "marker.toml")
    assert convert(bag, tmp_path / "out", *files).status == 0
    expected = sample_results("multi_joint_fault_6r").summary
    found = analyse(open_session(tmp_path / "out")).summary
    apart = differences(found, expected, "mean_error_deg")
    if encoding != "mono16":
        u = [joint["expanded_uncertainty_deg"] for joint in found["joints"]]
        assert (np.abs(apart) <= u).all()
        assert found["pairs"]["measured"] == expected["pairs"]["measured"]
        return
    np.testing.assert_allclose(apart, 0, atol=1e-9)
    apart = differences(found, expected, "expanded_uncertainty_deg")
    np.testing.assert_allclose(apart, 0, atol=1e-9)
    assert found["diagnosis"][0]["joint"] == 2


def test_a_folder_named_like_a_bag_is_refused(tmp_path: Path) -> None:
    (tmp_path / "bag.mcap").mkdir()
    assert "cannot be read as a bag" in convert(tmp_path / "bag.mcap", tmp_path / "out").refusal


def test_a_static_transform_without_a_turn_is_refused(session: Recording, tmp_path: Path) -> None:
    def spoil(contents: Contents) -> None:
        ((_, message),) = contents.topics["/tf_static"][1]
        message.transforms[0].transform.rotation.w = 0.0
        message.transforms[0].transform.rotation.z = 0.0
        message.transforms[0].transform.rotation.x = 0.0
        message.transforms[0].transform.rotation.y = 0.0

    said = refusal(tmp_path, bag_of("mcap", session, change=spoil))
    assert "/tf_static: turns left_optical by a quaternion of the length 0" in said


def test_a_camera_model_that_is_no_number_is_refused(session: Recording, tmp_path: Path) -> None:
    def spoil(contents: Contents) -> None:
        info = contents.topics["/left/camera_info"][1][0][1]
        info.k = np.where(np.arange(9) == 2, np.nan, info.k)

    said = refusal(tmp_path, bag_of("mcap", session, change=spoil))
    assert "/left/camera_info: has numbers that are none" in said


def test_a_message_that_names_a_joint_twice_is_left_out(session: Recording, tmp_path: Path) -> None:
    def spoil(contents: Contents) -> None:
        message = contents.topics["/joint_states"][1][1][1]
        message.name.append(message.name[0])
        message.position = np.append(message.position, 0.5)

    found = convert_contents(tmp_path, bag_of("mcap", session, change=spoil))
    assert len(found.encoders.t) == len(session.encoders.t) - 1
