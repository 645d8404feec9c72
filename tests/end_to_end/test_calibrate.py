"""From pictures of a board to a registered rig and a check, as a user types it."""

import errno
import json
import shutil
import tomllib
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pandas as pd
import pytest

from tests.support import recorded
from tests.support.beside import shared
from tests.support.command import SAMPLES, Outcome, read_summary, verify
from tests.support.simulated import FIXTURE, SMALL_BOARDS
from verify.io import results
from verify.io import rig as io_rig

WRITTEN = {"report.html", "report.pdf", "summary.json", "results"}


def boards(folder: Path, pairs: int, more: str = "", corners: str = "[9, 6]") -> Path:
    scenario = folder.with_suffix(".toml")
    scenario.write_text(SMALL_BOARDS.format(pairs=pairs).replace("[9, 6]", corners) + more)
    assert verify("simulate", scenario, "-o", folder).status == 0
    return folder


def calibrate_boards(folder: Path, place: Path, *options: str) -> Outcome:
    """Calibrate from pictures; rig.toml and the report go to a place."""
    out = ("-o", place / "rig.toml", "--report", place / "report")
    return verify("calibrate", "boards", folder, *out, *options)


def register_motion(session: Path, place: Path) -> Outcome:
    """Register base and LEDs from a session; rig.toml, marker.toml and the report go to a place."""
    out = ("-o", place / "rig.toml", "--marker", place / "marker.toml")
    return verify("calibrate", "register", session, *out, "--report", place / "report")


def matrices(rig: Path) -> np.ndarray:
    found, _ = io_rig.read(rig, registered=False)
    return np.array([found.left.matrix, found.right.matrix])


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("calibration")


@pytest.fixture(scope="module")
def pictures(place: Path) -> Path:
    return boards(place / "pictures", 14)


@pytest.fixture(scope="module")
def calibrated(place: Path, pictures: Path) -> tuple[Path, Path, Outcome]:
    message = calibrate_boards(pictures, place)
    return place / "rig.toml", place / "report", message


def test_pictures_of_a_board_become_a_rig_and_a_report(
    calibrated: tuple[Path, Path, Outcome], pictures: Path
) -> None:
    rig, report, message = calibrated
    assert message.status == 0, message.err
    assert {path.name for path in report.iterdir()} == WRITTEN
    assert "14 pairs" in message.out
    summary = read_summary(report)
    assert summary["kind"] == "calibration"
    assert summary["pairs"]["used"] == 14
    found, warnings = io_rig.read(rig, registered=False)
    assert warnings == ()
    assert not found.registered
    before = (report / "report.html").read_bytes()
    assert verify("report", report).status == 0
    assert (report / "report.html").read_bytes() == before
    assert "exists" in calibrate_boards(pictures, rig.parent).refusal
    refusal = calibrate_boards(pictures / "none", rig.parent / "none").refusal  # before any search
    assert "none/rig.toml: cannot be made" in refusal


def test_the_rig_holds_the_truth_within_what_it_states(
    calibrated: tuple[Path, Path, Outcome], pictures: Path
) -> None:
    found, _ = io_rig.read(calibrated[0], registered=False)
    truth, _ = io_rig.read(pictures / "rig_true.toml", registered=False)
    stated = dict(
        zip(found.covariance.parameters, found.covariance.standard_uncertainty, strict=True)
    )
    for side in ("left", "right"):
        one, other = getattr(found, side).matrix, getattr(truth, side).matrix
        for key, row, column in (("fx", 0, 0), ("cx", 0, 2), ("cy", 1, 2)):
            z = (one[row, column] - other[row, column]) / stated[f"{side}.{key}_px"]
            assert abs(z) < 4, (side, key)  # one draw of six: 4 is beyond chance
    baseline = 1e3 * np.linalg.norm(found.right.pan_center - found.left.pan_center)
    assert baseline == pytest.approx(170.0, abs=0.3)


@pytest.mark.slow
def test_the_same_pictures_give_the_same_figures(
    calibrated: tuple[Path, Path, Outcome], pictures: Path, tmp_path: Path
) -> None:
    rig, report, _ = calibrated
    assert calibrate_boards(pictures, tmp_path).status == 0
    # sums of thousands of corners repeat to their rounding
    np.testing.assert_allclose(matrices(rig), matrices(tmp_path / "rig.toml"), rtol=1e-9)
    one, other = read_summary(report), read_summary(tmp_path / "report")
    assert (one["pairs"], one["decisions"]) == (other["pairs"], other["decisions"])


def test_an_unregistered_rig_is_refused_by_a_run(
    calibrated: tuple[Path, Path, Outcome], tmp_path: Path
) -> None:
    session = shutil.copytree(SAMPLES / "quarter_circle_6r", tmp_path / "session")
    shutil.copy(calibrated[0], session / "rig.toml")
    refusal = verify("run", session, "-o", tmp_path / "out").refusal
    assert "robot_base: is missing" in refusal
    assert "calibrate register" in refusal


def test_a_board_on_the_base_registers_the_robot_and_the_check_holds(
    place: Path, calibrated: tuple[Path, Path, Outcome], tmp_path: Path
) -> None:
    fixture = boards(place / "fixture", 3, FIXTURE)
    out = tmp_path / "registered.toml"
    message = verify(
        "calibrate", "register", fixture, "--rig", calibrated[0], "-o", out,
        "--board-in-base", fixture / "board_in_base.toml", "--report", tmp_path / "registration",
    )  # fmt: skip
    assert message.status == 0, message.err
    assert "not stated" in message.err  # the fixture states no uncertainty: said
    inputs = json.loads((tmp_path / "registration" / "summary.json").read_text())["inputs"]
    assert {str(fixture / "board_in_base.toml"), str(calibrated[0])} <= set(inputs)
    found, _ = io_rig.read(out)
    truth = tomllib.loads((fixture / "rig_true.toml").read_text())["robot_base"]
    assert np.allclose(1e3 * found.rig_T_base[:3, 3], truth["position_mm"], atol=2.0)
    assert found.base_source == "fixture"
    assert "robot_base.rz_deg" in found.covariance.parameters
    held = verify("calibrate", "check", fixture, "--rig", out)
    assert held.status == 0, held.out
    assert "The calibration holds" in held.out


@pytest.mark.slow
def test_a_bumped_camera_fails_the_check_and_its_report_is_written(
    calibrated: tuple[Path, Path, Outcome], tmp_path: Path, pictures: Path
) -> None:
    rig, _ = io_rig.read(calibrated[0], registered=False)
    mount = rig.right.mount.copy()
    mount[:3, :3] = cv2.Rodrigues(np.deg2rad([0.0, 0.3, 0.0]))[0] @ mount[:3, :3]
    bumped = tmp_path / "bumped.toml"
    io_rig.write(bumped, replace(rig, right=replace(rig.right, mount=mount)))
    out = tmp_path / "check"
    message = verify("calibrate", "check", pictures, "--rig", bumped, "-o", out)
    assert message.status == 1
    assert "does not hold" in message.out
    assert message.out.endswith(f"Report: {out / 'report.html'} and {out / 'report.pdf'}\n")
    assert {path.name for path in out.iterdir()} == WRITTEN
    assert read_summary(out)["verdict"] == "not_held"
    again = verify("calibrate", "check", pictures, "--rig", bumped, "-o", out)
    assert "--force" in again.refusal


@pytest.mark.slow
def test_another_robots_readings_are_the_first_cause_named(tmp_path: Path) -> None:
    session = shutil.copytree(SAMPLES / "multi_joint_rv_3sd", tmp_path / "session")
    recorded.replace(session / "session.toml", '"rv_3sd_melfa"', '"iust_6r"')
    message = register_motion(session, tmp_path)
    assert '"iust_6r" is the robot that moved' in message.refusal
    assert "mirror" not in message.err


def test_a_motion_registers_base_and_leds(tmp_path: Path) -> None:
    session = SAMPLES / "multi_joint_rv_3sd"
    message = register_motion(session, tmp_path)
    assert message.status == 0, message.err
    assert "A constant offset of joints 1 and 6 that was there already cannot show" in message.out
    assert {path.name for path in (tmp_path / "report").iterdir()} == WRITTEN
    again = shutil.copytree(session, tmp_path / "session")
    for name in ("rig.toml", "marker.toml"):
        shutil.copy(tmp_path / name, again)
    run = verify("run", again, "-o", tmp_path / "run")
    assert run.status == 3, run.err  # joints 1 and 6 cannot be told: its tolerance is undecided
    summary = read_summary(tmp_path / "run")
    assert summary["diagnosis"] == []  # a healthy arm: nobody is accused
    visible = [joint["visible_fraction"] for joint in summary["joints"]]
    assert visible[0] == visible[5] == 0
    assert summary["joints"][0]["mean_error_deg"] is None


@pytest.mark.slow
def test_bad_pictures_are_refused_in_one_line(pictures: Path, tmp_path: Path) -> None:
    def refused(folder: Path, *options: str) -> str:
        return calibrate_boards(folder, tmp_path, *options).refusal

    assert "does not exist" in refused(tmp_path / "nowhere")
    empty = tmp_path / "empty"
    empty.mkdir()
    assert "board.toml" in refused(empty)
    assert "--square-mm: is missing" in refused(pictures, "--corners", "9x6")
    assert "9x7" in refused(pictures, "--corners", "nine", "--square-mm", "40")
    assert "9 x 6" in refused(pictures, "--corners", "7x5", "--square-mm", "40")
    odd = boards(tmp_path / "odd", 4, corners="[7, 5]")
    assert "Swap the two numbers" in refused(odd, "--corners", "5x7", "--square-mm", "40")
    blank = tmp_path / "blank"
    shutil.copytree(pictures, blank)
    for path in [*blank.glob("left/*"), *blank.glob("right/*")]:
        cv2.imwrite(str(path), np.full((360, 640), 90, np.uint8))
    assert "no board was found" in refused(blank)
    assert not (tmp_path / "rig.toml").exists()
    assert not (tmp_path / "report").exists()


@pytest.mark.slow
def test_pan_angles_in_radians_are_named_before_the_boards(tmp_path: Path) -> None:
    folder = boards(tmp_path / "turning", 12, "\n[bases]\nrange_deg = 15.0\n")
    frames = pd.read_csv(folder / "frames.csv")
    pans = ["pan_left_deg", "pan_right_deg"]
    frames[pans] = np.deg2rad(frames[pans]).round(6)
    frames.to_csv(folder / "frames.csv", index=False)
    refusal = calibrate_boards(folder, tmp_path).refusal
    for words in ("frames.csv: pan_left_deg spans", "as if in radians", "As they stand:"):
        assert words in refusal


@pytest.mark.parametrize("what", ["rig", "report"])
def test_a_disk_that_fills_up_leaves_neither_rig_nor_report(
    what: str, pictures: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    if what == "report":
        monkeypatch.setattr(results, "write_reports", full)
    place = tmp_path / "out"
    place.mkdir()
    out = place / "rig.toml" if what == "report" else place / "nowhere" / "rig.toml"
    message = verify("calibrate", "boards", pictures, "-o", out, "--report", place / "report")
    assert ("space" if what == "report" else "nowhere") in message.refusal
    assert list(place.iterdir()) == []


def test_options_of_the_other_way_of_registering_are_refused(pictures: Path) -> None:
    words = ("register", pictures, "--corners", "9x6", "-o", "/nowhere/rig.toml")
    assert "--corners" in verify("calibrate", *words).refusal


@pytest.mark.parametrize(
    ("rig", "marker"),
    [("frames.csv", "m.toml"), ("session.toml", "m.toml"), ("rig.toml", "encoders.csv")],
)
def test_a_rig_or_marker_does_not_replace_what_was_recorded(
    rig: str, marker: str, tmp_path: Path
) -> None:
    session = shutil.copytree(SAMPLES / "multi_joint_rv_3sd", tmp_path / "session")
    before = {path: path.read_bytes() for path in session.iterdir()}
    out = ("-o", session / rig, "--marker", session / marker, "--report", tmp_path / "report")
    message = verify("calibrate", "register", session, *out, "--force")
    assert f"would change {session}, which is read" in message.refusal
    assert {path: path.read_bytes() for path in session.iterdir()} == before


def test_a_rig_does_not_replace_a_picture_of_the_board(pictures: Path) -> None:
    picture = next(pictures.glob("left/*"))
    message = verify("calibrate", "boards", pictures, "-o", picture, "--force")
    assert f"would change {pictures}, which is read" in message.refusal


@pytest.mark.slow
@pytest.mark.shared
def test_the_recorded_boards_calibrate_as_typed(tmp_path: Path) -> None:
    folder = shared("sessions", "calibration_boards")
    message = calibrate_boards(folder, tmp_path)
    assert message.status == 0, message.err
    # far inside what OpenCV's own calibration of the same pictures misses by (its README: 0.3 px)
    rig = tmp_path / "rig.toml"
    assert np.allclose(matrices(rig), matrices(folder / "rig.toml"), atol=0.3)
    found, _ = io_rig.read(rig, registered=False)
    baseline = 1e3 * np.linalg.norm(found.right.pan_center - found.left.pan_center)
    assert baseline == pytest.approx(170.0, abs=0.1)


def test_a_board_ambiguous_by_a_quarter_turn_is_warned_of(tmp_path: Path) -> None:
    message = verify("board", "--corners", "8x8", "--square-mm", "20", "-o", tmp_path / "square")
    assert message.status == 0
    assert "quarter turn" in message.err
    other = verify("board", "--corners", "9x8", "--square-mm", "20", "-o", tmp_path / "other")
    assert "quarter turn" not in other.err
