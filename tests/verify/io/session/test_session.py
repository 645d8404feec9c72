""""""

import hashlib
import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import robots
from tests.support.recorded import (
    PAIRS,
    images,
    replace,
    write_folder,
    write_session,
    write_video,
)
from verify.errors import InputError
from verify.io.session.keys import parse_start
from verify.io.session.session import open_session


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return write_session(tmp_path / "tuesday")


def add(text: str) -> Callable[[Path], None]:
    def change(folder: Path) -> None:
        with (folder / "session.toml").open("a") as file:
            file.write(text)

    return change


def test_a_session_holds_the_values_of_its_files(folder: Path) -> None:
    session = open_session(folder)
    assert (session.name, session.robot, session.description) == ("tuesday", "iust_6r", "small")
    assert session.started == "2026-11-20T10:00:00Z"
    assert len(session) == PAIRS
    assert not session.open
    assert session.warnings == ()
    assert session.clock is None
    assert session.tolerance is None
    assert session.temperature_c is None
    assert_allclose(session.frames.t_left, 0.1 * np.arange(PAIRS))
    assert_allclose(session.frames.t_right, 0.1 * np.arange(PAIRS) + 0.004)
    assert_allclose(session.frames.pan_left, np.deg2rad(7.5))
    assert session.encoders.q.shape == (30, 6)
    assert_allclose(np.rad2deg(session.encoders.q[2]), [2, 3, 4, 5, 6, 7])


def test_every_optional_table_is_read(folder: Path) -> None:
    add(
        "[clock]\nencoder_offset_s = 0.137\nencoder_offset_standard_uncertainty_s = 0.0005\n"
        "[encoder_readings]\nresolution_deg = 0.01\ntime_standard_uncertainty_s = 0.0004\n"
        "[tolerance]\njoints_deg = 0.2\nposition_mm = 1.0\norientation_deg = 0.3\n"
        "[environment]\ntemperature_c = 23.0\n"
    )(folder)
    session = open_session(folder)
    assert (session.clock.encoder_offset, session.clock.standard_uncertainty) == (0.137, 0.0005)
    assert session.encoder_resolution == pytest.approx(np.deg2rad(0.01))
    assert session.encoder_time_standard_uncertainty == 0.0004
    assert_allclose(session.tolerance.joints, np.full(6, np.deg2rad(0.2)))
    assert session.tolerance.position == pytest.approx(0.001)
    assert session.tolerance.orientation == pytest.approx(np.deg2rad(0.3))
    assert session.temperature_c == 23.0
    assert session.warnings == ()


def test_each_joint_may_have_its_own_tolerance(folder: Path) -> None:
    add("[tolerance]\njoints_deg = [0.1, 0.2, 0.3, 0.4, 0.5, 1]\n")(folder)
    tolerance = open_session(folder).tolerance
    assert_allclose(np.rad2deg(tolerance.joints), [0.1, 0.2, 0.3, 0.4, 0.5, 1])
    assert tolerance.position is None


def test_pairs_are_the_images_that_were_recorded_with_their_times_and_pans(folder: Path) -> None:
    (folder / "frames.csv").write_text(
        "frame,t_left_s,t_right_s,pan_left_deg,pan_right_deg\n"
        + "".join(f"{i},{i},{i}.5,{i},-{i}\n" for i in range(PAIRS))
    )
    pairs = list(open_session(folder).pairs())
    assert [pair.frame for pair in pairs] == list(range(PAIRS))
    for i, (pair, left, right) in enumerate(zip(pairs, images(), images()[::-1], strict=True)):
        assert_array_equal(pair.left, left)
        assert_array_equal(pair.right, right)
        assert (pair.t_left, pair.t_right) == (i, i + 0.5)
        assert_allclose([pair.pan_left, pair.pan_right], np.deg2rad([i, -i]))


def test_a_folder_of_pngs_is_as_good_as_a_video(folder: Path) -> None:
    write_folder(folder / "left", images())
    replace(folder / "session.toml", '"left.mkv"', '"left"')
    pairs = list(open_session(folder).pairs())
    for pair, left in zip(pairs, images(), strict=True):
        assert_array_equal(pair.left, left)


def test_every_input_file_is_named_with_its_digest(folder: Path) -> None:
    inputs = open_session(folder).inputs
    names = ["session.toml", "rig.toml", "marker.toml", "left.mkv", "right.mkv"]
    for name in [*names, "frames.csv", "encoders.csv"]:
        digest = hashlib.sha256((folder / name).read_bytes()).hexdigest()
        assert inputs.pop(name) == f"sha256:{digest}"
    assert not inputs


def test_a_robot_file_in_the_folder_is_an_input_too(folder: Path) -> None:
    known = Path(robots.__file__).with_name("iust_6r.toml").read_bytes()
    (folder / "arm.toml").write_bytes(known)
    replace(folder / "session.toml", '"iust_6r"', '"arm.toml"')
    session = open_session(folder)
    assert session.arm.dof == 6
    assert session.inputs["arm.toml"] == f"sha256:{hashlib.sha256(known).hexdigest()}"


def test_files_saved_by_an_editor_on_windows_read_the_same(folder: Path) -> None:
    for name in ("session.toml", "rig.toml", "marker.toml", "frames.csv", "encoders.csv"):
        text = (folder / name).read_bytes()
        (folder / name).write_bytes(b"\xef\xbb\xbf" + text.replace(b"\n", b"\r\n"))
    assert open_session(folder).warnings == ()


def test_truth_is_never_opened(folder: Path) -> None:
    (folder / "truth.csv").mkdir()  # would fail, whoever reads it
    assert "truth.csv" not in open_session(folder).inputs


def test_an_unknown_key_is_named_with_the_one_that_was_meant(folder: Path) -> None:
    add("[clock]\nencoder_offset_s = 0.0\nencoder_ofset_s = 1.0\n[[later.thing]]\nx = 1\n")(folder)
    warnings = open_session(folder).warnings
    assert len(warnings) == 2
    assert "clock.encoder_ofset_s" in warnings[0]
    assert "`encoder_offset_s`" in warnings[0]
    assert "later" in warnings[1]


def test_files_of_two_registrations_are_warned_of(folder: Path) -> None:
    replace(
        folder / "rig.toml", 'source = "fixture"', 'source = "motion"\nregistration = "sha256:1"'
    )
    assert any("sha256:1 and none" in warning for warning in open_session(folder).warnings)


def test_a_covariance_of_an_led_that_is_not_there_is_warned_of(folder: Path) -> None:
    with (folder / "rig.toml").open("a") as file:
        file.write(
            '[covariance]\nparameters = ["led.A.x_mm", "led.Z.x_mm"]\n'
            "standard_uncertainty = [0.1, 0.1]\ncorrelation = [[1.0, 0.0], [0.0, 1.0]]\n"
        )
    warnings = open_session(folder).warnings
    assert len(warnings) == 1
    assert '"Z"' in warnings[0]


def test_an_open_session_is_measured_to_its_shortest_stream(folder: Path) -> None:
    add('recording = "open"\n')(folder)
    write_video(folder / "right.mkv", images(PAIRS - 2))
    with (folder / "frames.csv").open("a") as file:
        file.write("6,0.6,0.604\n7,0.7,0.7")  # the power went in the middle of a number
    with (folder / "encoders.csv").open("ab") as zeros:
        zeros.write(bytes(512))  # what a file system leaves of blocks that were never written
    session = open_session(folder)
    assert session.open
    assert len(session) == len(list(session.pairs())) == PAIRS - 2
    assert len(session.frames.t_left) == PAIRS - 2
    assert len(session.encoders) == 30
    text = "\n".join(session.warnings)
    assert "7 rows, 6 left and 4 right images" in text
    assert "frames.csv: the last line was cut off" in text
    assert "encoders.csv: the last line was cut off" in text


def test_a_relative_folder_has_its_own_name(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(folder)
    assert open_session(".").name == "tuesday"


def complaint(folder: Path) -> str:
    """Open and read a session that has something wrong; return the one line that says so."""
    with pytest.raises(InputError) as caught:
        for _ in open_session(folder).pairs():
            pass
    line = str(caught.value)
    assert line.isprintable()
    return line


def swap(file: str, old: str, new: str) -> Callable[[Path], None]:
    return lambda folder: replace(folder / file, old, new)


def write(file: str, content: bytes) -> Callable[[Path], None]:
    def change(folder: Path) -> None:
        (folder / file).write_bytes(content)

    return change


def drop(file: str) -> Callable[[Path], None]:
    return lambda folder: (folder / file).unlink()


def damaged_png(folder: Path) -> None:
    write_folder(folder / "left", images())
    file = folder / "left" / "000004.png"
    file.write_bytes(file.read_bytes()[:-100])
    replace(folder / "session.toml", '"left.mkv"', '"left"')


def flipped_bit(folder: Path) -> None:
    data = bytearray((folder / "right.mkv").read_bytes())
    data[len(data) // 2] ^= 1
    (folder / "right.mkv").write_bytes(data)


def other_size(side: str) -> Callable[[Path], None]:
    return lambda folder: write_video(folder / side, [picture[:40] for picture in images()])


def video_of(count: int) -> Callable[[Path], None]:
    return lambda folder: write_video(folder / "right.mkv", (images() * 2)[:count])


def link_outside(folder: Path) -> None:
    outside = folder.parent / "secret.toml"
    outside.write_text("format = 1")
    (folder / "rig.toml").unlink()
    (folder / "rig.toml").symlink_to(outside)


def absorption_of_one_joint(folder: Path) -> None:
    rows = "[0.0]," * 12
    replace(folder / "rig.toml", '"fixture"', f'"motion"\nabsorption = [{rows}]')


def loop(name: str) -> Callable[[Path], None]:
    def change(folder: Path) -> None:
        (folder / name).unlink()
        (folder / name).symlink_to(name)

    return change


def pipe(folder: Path) -> None:
    (folder / "left.mkv").unlink()
    os.mkfifo(folder / "left.mkv")


def open_pipe(folder: Path) -> None:
    pipe(folder)
    add('recording = "open"')(folder)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (drop("rig.toml"), ["session.toml, rig", "does not exist"]),
        (drop("left.mkv"), ["session.toml, left", "does not exist"]),
        (write("encoders.csv", b""), ["encoders.csv", "is empty"]),
        (write("left.mkv", b""), ["left.mkv", "is empty"]),
        (write("session.toml", b'format = 1\nrobot = "a\n'), ["session.toml, line 2, column"]),
        (write("session.toml", b"format = 1\n# \xff\n"), ["session.toml, line 2", "UTF-8"]),
        (write("session.toml", "format = 1".encode("utf-16")), ["session.toml: is UTF-16; UTF-8"]),
        (loop("session.toml"), ["session.toml: too many levels of symbolic links"]),
        (swap("session.toml", "format = 1", "format = 2"), ["format: is 2", "format 1"]),
        (swap("session.toml", "format = 1", ""), ["format: is missing"]),
        (swap("session.toml", '"rig.toml"', "3"), ["session.toml, rig: is 3", "text"]),
        (swap("session.toml", 'left = "left.mkv"', ""), ["session.toml, left: is missing"]),
        (add('recording = "opne"'), ['recording: is "opne"', "`open`"]),
        *((swap("session.toml", '"small"', number),
           [f"description: is {number}; a text in quotes is expected"])
          for number in ("nan", "1e+300")),
        (add(f"[clock]\nencoder_offset_s = 1{400 * '0'}"), ["clock.encoder_offset_s", "at most"]),
        (add("[clock]\nencoder_offset_s = nan"), ["clock.encoder_offset_s: is nan", "finite"]),
        (add("[clock]\n"), ["clock.encoder_offset_s: is missing"]),
        (add("[tolerance]\njoints_deg = [0.1, 0.2]"), ["tolerance.joints_deg", "list of 2", "6"]),
        (add('[tolerance]\njoints_deg = "0.1"'), ["joints_deg", '"0.1"', "number or a list"]),
        (add("[tolerance]\njoints_deg = [1, 1, 1, 1, 1, 0]"), ["joints_deg[5]: is 0", "positive"]),
        (add("[tolerance]\nposition_mm = -1.0"), ["tolerance.position_mm: is -1.0"]),
        (add("[encoder_readings]\nresolution_deg = -0.1"), ["encoder_readings.resolution_deg"]),
        (swap("session.toml", '"iust_6r"', '"iust_5r"'), ['"iust_5r"', '"iust_6r"', "toml, robot"]),
        (swap("session.toml", '"iust_6r"', '"../arm.urdf"'), ["robot", "outside the folder"]),
        (swap("session.toml", '"iust_6r"', '"arm.urdf"'), ["robot", "does not exist"]),
        (swap("session.toml", '"rig.toml"', '"../rig.toml"'), ["rig", "outside the folder"]),
        (swap("session.toml", '"rig.toml"', '"/etc/hostname"'), ["rig", "outside the folder"]),
        (swap("session.toml", '"rig.toml"', '""'), ["rig: names nothing"]),
        (swap("session.toml", '"rig.toml"', '"."'), ["is a folder"]),
        (link_outside, ["rig", "outside the folder"]),
        (pipe, ["left.mkv", "not a plain file"]),
        (open_pipe, ["left.mkv", "not a plain file"]),
        (swap("session.toml", '"right.mkv"', '"left.mkv"'), ["right", "each camera"]),
        (swap("session.toml", '"rig.toml"', '"a\\u001b[31m\\nb.toml"'), ["\\x1b[31m\\nb.toml"]),
        (video_of(PAIRS - 1), ["right.mkv", "has 5 images", "6 rows", "open"]),
        (video_of(PAIRS + 1), ["right.mkv", "has 7 images", "6 rows"]),
        (flipped_bit, ["right.mkv", "of 6 is damaged"]),
        (write("left.mkv", b"not a video" * 100), ["left.mkv", "not a video"]),
        (damaged_png, ["000004.png", "damaged"]),
        (other_size("left.mkv"), ["left.mkv", "image 0 is 64 x 40 px", "64 x 48"]),
        (other_size("right.mkv"), ["right.mkv", "image 0 is 64 x 40 px", "64 x 48"]),
        (swap("rig.toml", "20.0, 650.0]", '"20", 650.0]'), ["position_mm[1]", '"20"']),
        (absorption_of_one_joint, ["absorption", "1 columns", "6 joints"]),
    ],
)  # fmt: skip
def test_errors_are_one_line_with_the_place(
    folder: Path,
    capfd: pytest.CaptureFixture[str],
    change: Callable[[Path], None],
    message: list[str],
) -> None:
    change(folder)
    line = complaint(folder)
    for words in message:
        assert words in line
    assert capfd.readouterr() == ("", "")  # no line of OpenCV's, ffmpeg's or libpng's beside ours


@pytest.mark.parametrize("name", ["nowhere", "rig.toml", "a\nb\x1b[31m", "zero\0byte"])
def test_a_file_instead_of_a_folder_is_refused(folder: Path, name: str) -> None:
    assert "tuesday" in complaint(folder / name)


def test_a_file_that_may_not_be_read_is_named(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    genuine = Path.read_bytes

    def guarded(path: Path) -> bytes:  # root, who runs this in a container, may read everything
        if path.name == "rig.toml":
            raise PermissionError(13, "Permission denied", str(path))
        return genuine(path)

    monkeypatch.setattr(Path, "read_bytes", guarded)
    line = complaint(folder)
    assert "rig.toml: permission denied" in line
    assert "Grant access" in line


def test_an_open_session_without_one_whole_pair_is_refused(folder: Path) -> None:
    add('recording = "open"')(folder)
    write_folder(folder / "left", images())
    (folder / "left" / "000000.png").write_bytes(b"\x89PNG")
    replace(folder / "session.toml", '"left.mkv"', '"left"')
    assert "before the first whole pair" in complaint(folder)


def test_a_start_without_a_zone_is_taken_as_utc() -> None:
    assert parse_start("2025-06-01T10:00:00") == parse_start("2025-06-01T12:00:00+02:00")
    assert parse_start(None) is None
