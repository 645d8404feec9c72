"""What other programs read in the files that are written for them."""

import os
import shutil
import subprocess
import sys
import time
from datetime import datetime
from pathlib import Path

import cv2
import numpy as np
import pandas as pd
import pytest
import scipy.io
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory

from reports import Results
from tests.support.command import SAMPLES, sample_results, verify
from tests.support.recorded import write_session
from verify.io.results import write_report_folder
from verify.io.session.session import open_session

NAME = "multi_joint_fault_6r"


@pytest.fixture(scope="module")
def results() -> Results:
    return sample_results(NAME)


@pytest.fixture(scope="module")
def report(results: Results, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("report") / "out"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("verify.io.results.write_reports", lambda *_: None)  # nobody reads them here
        write_report_folder(results, out, force=False)
    return out


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_session(tmp_path_factory.mktemp("small") / "session")


def test_evo_finds_the_reports_position_error(
    report: Path, results: Results, tmp_path: Path
) -> None:
    from evo.core.metrics import APE, PoseRelation, StatisticsType
    from evo.core.sync import associate_trajectories
    from evo.tools.file_interface import read_tum_trajectory_file

    assert verify("convert", report, "-o", tmp_path / "tum", "--to", "tum").status == 0
    files = [tmp_path / "tum" / f"{name}.tum" for name in ("encoders", "measured")]
    pair = associate_trajectories(*map(read_tum_trajectory_file, files))
    found = {}
    for relation in (PoseRelation.translation_part, PoseRelation.rotation_angle_deg):
        metric = APE(relation)
        metric.process_data(pair)
        found[relation] = metric.get_statistic(StatisticsType.rmse)
    summary = results.summary
    rms = summary["position"]["rms_error_mm"] * 1e-3
    assert found[PoseRelation.translation_part] == pytest.approx(rms, abs=1e-6)
    rms = summary["orientation"]["rms_error_deg"]
    assert found[PoseRelation.rotation_angle_deg] == pytest.approx(rms, abs=1e-6)


def test_tables_keep_every_digit(report: Path, results: Results, tmp_path: Path) -> None:
    frames = results.table("frames")
    assert verify("convert", report, tmp_path / "csv", "--to", "csv").status == 0
    found = pd.read_csv(tmp_path / "csv" / "frames.csv")
    np.testing.assert_array_equal(found["x_mm"], frames["x_mm"])
    assert verify("convert", report, "-o", tmp_path / "r.mat").status == 0
    read = scipy.io.loadmat(tmp_path / "r.mat", simplify_cells=True)
    np.testing.assert_array_equal(read["frames"]["q2_error_deg"], frames["q2_error_deg"])
    assert list(read["frames"]["status"]) == list(frames["status"])
    assert read["pose_measured"]["position_m"].shape == (60, 3)


def test_mcap_of_results_is_read_by_other_code(
    report: Path, results: Results, tmp_path: Path
) -> None:
    assert verify("convert", report, "-o", tmp_path / "r.mcap").status == 0
    frames = results.table("frames")
    poses, joints = [], []
    with (tmp_path / "r.mcap").open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        for _, channel, message, content in reader.iter_decoded_messages():
            if channel.topic == "/flange/measured":
                p = content.pose.position
                poses.append([message.log_time, p.x, p.y, p.z])
            elif channel.topic == "/joint_states/encoders":
                assert content.name == [f"q{j}" for j in range(1, 7)]
                joints.append(content.position)
    start = pd.Timestamp(results.summary["session"]["started"]).value
    np.testing.assert_allclose(
        np.array(poses)[:, 0], start + frames["t_s"].to_numpy() * 1e9, rtol=0, atol=512
    )
    np.testing.assert_allclose(np.array(poses)[:, 1:] * 1e3, frames[["x_mm", "y_mm", "z_mm"]])
    expected = frames[[f"q{j}_encoder_deg" for j in range(1, 7)]]
    np.testing.assert_allclose(np.rad2deg(joints), expected, atol=1e-9)


def test_mcap_of_a_session_holds_its_pictures_and_comes_back(session: Path, tmp_path: Path) -> None:
    given = open_session(session)
    assert verify("convert", session, "-o", tmp_path / "s.mcap").status == 0
    pictures = []
    with (tmp_path / "s.mcap").open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        for _, _, _, content in reader.iter_decoded_messages(["/left/image_raw"]):
            assert content.encoding == "mono8"
            pictures.append(np.frombuffer(content.data, np.uint8).reshape(48, 64))
    assert all(map(np.array_equal, pictures, given.left.images()))
    options = ("--robot", "iust_6r", "--marker", session / "marker.toml")
    assert verify("convert", tmp_path / "s.mcap", "-o", tmp_path / "back", *options).status == 0
    assert (tmp_path / "back" / "encoders.csv").is_file()
    boards = tmp_path / "boards"  # of `verify calibrate boards`
    (boards / "left").mkdir(parents=True)
    (boards / "frames.csv").write_text("frame,pan_left_deg,pan_right_deg\n0,5,-5\n")
    said = verify("convert", tmp_path / "s.mcap", "-o", boards, *options, "--force").refusal
    assert "boards: holds left, of board pictures" in said
    assert sorted(path.name for path in boards.iterdir()) == ["frames.csv", "left"]


def test_jpegs_go_through_as_they_are(session: Path, tmp_path: Path) -> None:
    from verify.io.encoding import VideoWriter

    data = [cv2.imencode(".jpg", i)[1].tobytes() for i in open_session(session).left.images()]
    for side in ("left", "right"):
        with VideoWriter(session / f"{side}.mkv", 25.0) as video:
            for picture in data:
                video.add_jpeg(picture, (64, 48))
    assert verify("convert", session, "-o", tmp_path / "s.mcap").status == 0
    with (tmp_path / "s.mcap").open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        topic = "/right/image_raw/compressed"
        found = [bytes(m.data) for *_, m in reader.iter_decoded_messages([topic])]
    assert found == data


def test_without_its_extra_rerun_is_refused_with_what_to_install(
    report: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "rerun", None)  # as if it were not installed
    assert "pip install" in verify("convert", report, "-o", tmp_path / "r.rrd").refusal
    assert list(tmp_path.iterdir()) == []


def test_rerun_takes_no_folder_whose_name_is_not_utf_8(report: Path, tmp_path: Path) -> None:
    folder = tmp_path / os.fsdecode(b"lat\xfcn")
    folder.mkdir()
    assert "is not UTF-8" in verify("convert", report, "-o", folder / "r.rrd").refusal
    assert list(folder.iterdir()) == []


@pytest.mark.slow
def test_rerun_verifies_a_recording(report: Path, session: Path, tmp_path: Path) -> None:
    for name, source in (("r.rrd", report), ("s.rrd", session)):
        assert verify("convert", source, "-o", tmp_path / name).status == 0
        command = [str(Path(sys.executable).with_name("rerun")), "rrd", "verify", tmp_path / name]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
        assert "1 file verified without error" in done.stdout + done.stderr


def test_nothing_is_overwritten_and_no_format_is_guessed(report: Path, tmp_path: Path) -> None:
    assert "--to is one of tum" in verify("convert", report, "-o", tmp_path / "out").refusal
    (tmp_path / "r.mat").write_text("mine")
    assert "exists" in verify("convert", report, "-o", tmp_path / "r.mat").refusal
    assert (tmp_path / "r.mat").read_text() == "mine"
    assert verify("convert", report, "-o", tmp_path / "r.mat", "--force").status == 0
    said = verify("convert", report, "-o", tmp_path / "x.mat", "--left", "/left").refusal
    assert "--left: does nothing with" in said
    assert "another kind" in verify("convert", tmp_path, "-o", tmp_path / "x.mat").refusal
    assert [p.name for p in tmp_path.iterdir()] == ["r.mat"]


def test_a_session_shows_its_clock_is_not_known(tmp_path: Path) -> None:
    done = verify("convert", SAMPLES / NAME, "-o", tmp_path / "tum", "--to", "tum")
    assert "states no [clock]" in done.err
    assert [p.name for p in (tmp_path / "tum").iterdir()] == ["encoders.tum"]


@pytest.mark.parametrize("zone", ["", "Z", "+02:00"])
def test_an_export_dates_its_messages_by_utc_wherever_it_is_made(
    zone: str, session: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shutil.copytree(session, tmp_path / "s")
    text = (tmp_path / "s" / "session.toml").read_text()
    start = "2026-11-20T10:00:00"
    assert f"started = {start}Z" in text
    stated = text.replace(f"{start}Z", f"{start}.25{zone}")
    (tmp_path / "s" / "session.toml").write_text(stated)
    monkeypatch.setenv("TZ", "America/New_York")
    time.tzset()
    try:
        assert verify("convert", tmp_path / "s", "-o", tmp_path / "s.mcap").status == 0
    finally:
        monkeypatch.undo()
        time.tzset()
    with (tmp_path / "s.mcap").open("rb") as file:
        first = next(make_reader(file).iter_messages(["/joint_states/encoders"]))[2].log_time
    given = open_session(session)
    t = given.encoders.t[0] + (0.0 if given.clock is None else given.clock.encoder_offset)
    utc = datetime.fromisoformat(f"{start}.25{zone or 'Z'}").timestamp()
    assert first * 1e-9 == pytest.approx(utc + t, abs=1e-6)


def test_an_export_never_touches_its_source(session: Path) -> None:
    before = {path: path.read_bytes() for path in session.iterdir()}
    for out, kind in ((session, "csv"), (session / "session.toml", "mat")):
        said = verify("convert", session, "-o", out, "--to", kind, "--force").refusal
        assert f"would change {session}" in said
    assert {path: path.read_bytes() for path in session.iterdir()} == before
