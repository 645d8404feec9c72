"""Each kind of bad input: one clear line that names the place, status 2, nothing written."""

import os
import re
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pandas as pd
import pytest

from tests.support.command import SAMPLES, read_summary, verify
from tests.support.commands import COMMANDS

SAMPLE = "multi_joint_fault_6r"


@pytest.fixture
def session(tmp_path: Path) -> Path:
    return shutil.copytree(SAMPLES / SAMPLE, tmp_path / "session")


def edit(name: str, old: str, new: str, count: int = 1) -> Callable[[Path], None]:
    def change(folder: Path) -> None:
        path = folder / name
        text = path.read_text()
        assert re.search(old, text, flags=re.MULTILINE), f"{old} is not in {name}"
        path.write_text(re.sub(old, new, text, count=count, flags=re.MULTILINE))

    return change


def remove(name: str) -> Callable[[Path], None]:
    return lambda folder: (folder / name).unlink()


def cut_short(folder: Path) -> None:
    data = (folder / "right.mkv").read_bytes()
    (folder / "right.mkv").write_bytes(data[: len(data) // 2])


def five_joints(folder: Path) -> None:
    readings = pd.read_csv(folder / "encoders.csv")
    readings.iloc[:, :-1].to_csv(folder / "encoders.csv", index=False)


def log_of_half_a_second(folder: Path) -> None:
    readings = pd.read_csv(folder / "encoders.csv")
    readings[readings["t_s"] < 1.6].to_csv(folder / "encoders.csv", index=False)


def other_size(folder: Path) -> None:
    edit("rig.toml", r"image_size = .*", "image_size = [1920, 1080]")(folder)
    edit("rig.toml", r"camera_matrix = .*", "camera_matrix = [[1500.0, 0.0, 960.0], "
         "[0.0, 1500.0, 540.0], [0.0, 0.0, 1.0]]", count=2)(folder)  # fmt: skip


def in_radians(folder: Path) -> None:
    readings = pd.read_csv(folder / "encoders.csv", index_col=0)
    np.deg2rad(readings).to_csv(folder / "encoders.csv", float_format="%.6f")


def pairs_in_milliseconds(folder: Path) -> None:
    frames = pd.read_csv(folder / "frames.csv", index_col=0)
    (frames * 1e3).to_csv(folder / "frames.csv", float_format="%.3f")


def without_leds(folder: Path) -> None:
    dark = np.random.default_rng(1).normal(6, 1.5, (720, 1280)).clip(0, 255).astype(np.uint8)
    for side in ("left", "right"):
        (folder / f"{side}.mkv").unlink()
        (folder / side).mkdir()
        for i in range(3):
            assert cv2.imwrite(str(folder / side / f"{i:06d}.png"), dark)
        edit("session.toml", rf'{side} = ".*"', f'{side} = "{side}"')(folder)
    pd.read_csv(folder / "frames.csv").head(3).to_csv(folder / "frames.csv", index=False)


def huge_cut_video(folder: Path) -> None:
    edit("session.toml", "format = 1", 'format = 1\nrecording = "open"')(folder)
    (folder / "left.mkv").write_bytes(b"")
    os.truncate(folder / "left.mkv", 20_000_000_000)  # no block of it stands on the disk


CASES = {
    "no folder": (shutil.rmtree, "session"),
    "no session.toml": (remove("session.toml"), "session.toml"),
    "a file is missing": (remove("encoders.csv"), "encoders.csv"),
    "a truncated video": (cut_short, "right.mkv"),
    "times that go back": (edit("frames.csv", r"^5,([\d.]+)", "5,0.001"), "line 7"),
    "five joints": (five_joints, "5 joint columns"),
    "a log that ends early": (log_of_half_a_second, "encoders.csv: the readings cover 9 of 60"),
    "an unknown robot": (edit("session.toml", "iust_6r", "iust_5r"), 'did you mean "iust_6r"'),
    "images of another size": (other_size, "1920"),
    "a TOML syntax error": (
        edit("marker.toml", r"led_diameter_mm = ", "led_diameter_mm == "), "line"),
    "another format": (edit("session.toml", "format = 1", "format = 7"), "format"),
    "readings in radians": (in_radians, "radians"),
    "pairs in milliseconds": (pairs_in_milliseconds, "The pairs' times look like milliseconds"),
    "pictures without an LED": (without_leds, "4 LEDs"),
    "a huge file as a cut video": (huge_cut_video, "left.mkv: is not a video"),
    "keys within keys": (edit("rig.toml", "format = 1", "format = 1\n" + '"a".' * 20_000 + "b = 1"),
                         "rig.toml: is nested too deeply"),
}  # fmt: skip


@pytest.mark.parametrize("case", CASES)
def test_bad_input_gets_one_line_and_leaves_nothing(
    case: str, session: Path, tmp_path: Path
) -> None:
    spoil, named = CASES[case]
    spoil(session)
    left = list(tmp_path.iterdir())
    assert named in verify("run", session, "-o", tmp_path / "out").refusal
    assert list(tmp_path.iterdir()) == left


def test_an_unknown_key_is_a_warning_that_names_it(session: Path, tmp_path: Path) -> None:
    edit("session.toml", "format = 1", 'format = 1\ndescribtion = "x"')(session)
    outcome = verify("run", session, "-o", tmp_path / "out")
    assert outcome.status in (0, 1, 3)
    assert "describtion" in outcome.err


def test_pictures_whose_times_are_exchanged_are_named(session: Path, tmp_path: Path) -> None:
    edit("frames.csv", "t_left_s,t_right_s", "t_right_s,t_left_s")(session)
    refusal = verify("run", session, "-o", tmp_path / "out").refusal
    assert "frames.csv: the pictures do not agree with it; t_left_s and t_right_s" in refusal
    assert re.search(r"exchanged fits: \d+ of 16 pairs from frame \d+ on can be measured", refusal)
    assert not (tmp_path / "out").exists()


def test_an_output_folder_that_exists_is_refused_before_any_work(
    session: Path, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    out.mkdir()
    (out / "precious.txt").write_text("mine")
    assert "--force" in verify("run", session, "-o", out).refusal
    assert [p.name for p in out.iterdir()] == ["precious.txt"]


@pytest.mark.parametrize("read", ["session", "other"])
@pytest.mark.parametrize(
    "command", [("run",), ("calibrate", "check"), ("identify",), ("batch",)], ids=" ".join
)
def test_results_do_not_go_into_a_session(
    command: tuple[str, ...], read: str, session: Path, tmp_path: Path
) -> None:
    shutil.copytree(session, tmp_path / "other")
    before = {path: path.read_bytes() for path in session.iterdir()}
    force = ["--force"] * (command != ("batch",))
    refusal = verify(*command, tmp_path / read, "-o", session, *force).refusal
    assert f"{session}: is a session" in refusal
    assert {path: path.read_bytes() for path in session.iterdir()} == before


@pytest.mark.parametrize(
    ("words", "named"),
    [
        (["rum"], "verify --help"),
        (["run"], "verify --help"),
        (["run", "--no-such-option", "x"], "verify --help"),
        (["run", SAMPLES], "Give one of its sessions: multi_joint_fault_6r, "),
        *((["run", SAMPLES / SAMPLE, f"--tolerance={wrong}"], "--tolerance")
          for wrong in ("abc", "-0.2", "0.2,0.3", "nan")),
        *((["run", SAMPLES / SAMPLE, f"--tolerance={wrong}"], f"write {right}.")
          for wrong, right in (("0,2", "0.2"), ("1,5", "1.5"))),
    ],
)  # fmt: skip
def test_wrong_usage_is_one_line_and_status_2(
    words: list[str | Path], named: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert named in verify(*words).refusal
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("OMP_NUM_THREADS", "abc"),
        ("OMP_NUM_THREADS", "4,0"),
        ("SOURCE_DATE_EPOCH", "abc"),
        ("SOURCE_DATE_EPOCH", "99999999999999999"),
    ],
)
def test_a_wrong_environment_variable_is_named(
    name: str, value: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(name, value)
    refusal = verify("run", SAMPLES / SAMPLE, "-o", tmp_path / "out").refusal
    assert refusal.startswith(f'error: {name}: is "{value}"; ')


def test_lists_of_threads_and_empty_variables_are_taken(tmp_path: Path) -> None:
    words = [sys.executable, "-m", "verify", "run", SAMPLES / SAMPLE, "-o", tmp_path / "out"]
    values = {"OMP_NUM_THREADS": "200,2", "SOURCE_DATE_EPOCH": "", "NUMEXPR_NUM_THREADS": ""}
    done = subprocess.run(words, capture_output=True, text=True, env=os.environ | values)
    assert done.returncode in (0, 1, 3), done.stderr


@pytest.mark.parametrize(
    ("words", "named"),
    [
        (["run", ""], "SOURCE: is empty"),
        (["run", SAMPLES / SAMPLE, "-o", ""], "--out: is empty"),
        (["run", SAMPLES / SAMPLE, "--rig", ""], "--rig: is empty"),
        (["batch", SAMPLES, ""], "FOLDERS: is empty"),
        (["calibrate", "check", ""], "SOURCE: is empty"),
    ],
)
def test_an_empty_word_is_not_the_current_folder(
    words: list[str | Path], named: str, session: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(session)
    before = list(session.iterdir())
    assert named in verify(*words).refusal
    assert list(session.iterdir()) == before


def test_a_check_of_what_is_not_there_does_not_ask_for_a_rig(tmp_path: Path) -> None:
    assert "lost: does not exist" in verify("calibrate", "check", tmp_path / "lost").refusal


@pytest.mark.parametrize("command", ["run", "batch", "identify"])
def test_a_link_to_itself_is_named_as_that(command: str, tmp_path: Path) -> None:
    (tmp_path / "loop").symlink_to("loop")
    done = verify(command, tmp_path / "loop", "-o", tmp_path / "out")
    assert "loop: too many levels of symbolic links" in done.refusal


FLOAT_OPTIONS = [
    (name, option)
    for name in COMMANDS
    for option in re.findall(r"--[a-z-]+(?= <float)", verify(*name.split(), "--help").out)
]


@pytest.mark.parametrize("value", ["nan", "inf", "-inf"])
@pytest.mark.parametrize(("command", "option"), FLOAT_OPTIONS)
def test_no_number_on_the_command_line_may_be_infinite(
    command: str, option: str, value: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    argument = {"board": [], "emulate": ["gripper"]}.get(command, ["x"])
    assert option in verify(*command.split(), *argument, f"{option}={value}").refusal
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("pairs", [1, 2, 3, 4])
def test_a_few_pairs_alone_give_a_refusal_or_no_false_verdict(
    session: Path, tmp_path: Path, pairs: int
) -> None:
    edit("session.toml", "format = 1", 'format = 1\nrecording = "open"')(session)
    frames = (session / "frames.csv").read_text().splitlines(keepends=True)
    (session / "frames.csv").write_text("".join(frames[: pairs + 1]))
    outcome = verify("run", session, "-o", tmp_path / "out", "--tolerance", "0.2")
    if pairs == 1:  # the arm moves, and nothing says how
        assert "the robot moved between the two pictures" in outcome.refusal
        assert "+4.2 ms after the left one" in verify("calibrate", "check", session).refusal
        return
    joints = read_summary(tmp_path / "out")["joints"]
    assert {j["verdict"] for k, j in enumerate(joints) if k != 1} <= {"conform", "undecided"}
    assert joints[1]["verdict"] in ("nonconform", "undecided")  # 0.35° by scenario
