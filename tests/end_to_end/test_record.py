"""`verify record`, and registration without a fixture: from uncalibrated cameras to a report."""

import json
import shutil
import signal
import subprocess
import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from robots.transforms import invert
from tests.support.command import ROOT, read_summary, verify
from tests.support.small_disk import mounted
from verify.io import fiducials
from verify.io import rig as io_rig
from verify.io.session.session import open_recording
from verify.simulation import library
from verify.simulation.session.simulate import SimulatedSession, simulate_session

# Smaller pictures, so that a busy machine keeps up; the true world is what the scenario says.
SMALL = (
    (ROOT / "verify" / "simulation" / "scenarios" / "multi_joint_rv_3sd.toml")
    .read_text()
    .partition("[uncertainty]")[0]
    .replace("[rig]\n", "[rig]\nimage_size = [640, 360]\n")
    .replace("[1012.4, 1011.1]", "[506.2, 505.5]")
    .replace("[646.3, 355.2]", "[322.9, 177.4]")
    .replace("[1008.7, 1007.9]", "[504.3, 503.9]")
    .replace("[634.8, 363.6]", "[317.2, 181.6]")
)
BOARDS = """format = 1
seed = 4
[boards]
pairs = 14
square_mm = 60.0
distance_mm = [900.0, 1500.0]
[bases]
middle_deg = {pan}
[rig]
image_size = [640, 360]
[rig.left]
focal_px = [506.2, 505.5]
principal_point_px = [322.9, 177.4]
distortion = [-0.085, 0.06, 0.0006, -0.0004, 0.0]
[rig.right]
focal_px = [504.3, 503.9]
principal_point_px = [317.2, 181.6]
distortion = [-0.079, 0.052, -0.0005, 0.0007, 0.0]
"""
STATION = """format = 1
robot = "rv_3sd_melfa"
left = {{ source = "sim", rate_hz = 8.0 }}
right = {{ source = "sim", rate_hz = 8.0 }}
encoders = {{ driver = "sim", rate_hz = 100.0 }}
sim = {{ scenario = "small.toml"{events} }}
{more}"""


def station(folder: Path, name: str, more: str = "", events: str = "") -> Path:
    (folder / "small.toml").write_text(SMALL)
    (folder / name).write_text(STATION.format(more=more, events=events))
    return folder / name


def event(what: str, **more: object) -> str:
    keys = ", ".join(
        f"{k} = {json.dumps(v)}" for k, v in {"what": what, "at_s": 0.0, **more}.items()
    )
    return f", event = [{{ {keys} }}]"


def started(path: Path, *words: str | Path) -> "subprocess.Popen[str]":
    command = [sys.executable, "-m", "verify", "record", str(path), "--json", *map(str, words)]
    return subprocess.Popen(command, stdout=subprocess.PIPE, text=True, cwd=path.parent)


def until(process: "subprocess.Popen[str]", pairs: int) -> dict[str, object]:
    """Listen until so many pairs are recorded."""
    for line in process.stdout:
        said = json.loads(line)
        if said["type"] == "recording" and said["pairs"] >= pairs:
            return said
    pytest.fail(f"ended with {process.wait()}")


def base_error(truth: SimulatedSession, found: Path) -> tuple[np.ndarray, np.ndarray]:
    """The registered base less the true one and its uncertainty, (6,), mm and degrees.

    Compared from the left camera: the rigs' own frames are conventions.
    """
    rig, camera = io_rig.read(found)[0], truth.world.bench.cameras[0]
    true = invert(camera.rig_T_camera(truth.true_pan[0, 0])) @ truth.world.bench.rig_T_base
    base = rig.left.rig_T_camera(rig.left.pan) @ true
    turn = Rotation.from_matrix(rig.rig_T_base[:3, :3] @ base[:3, :3].T).as_rotvec(degrees=True)
    u = [rig.covariance.by_name[f"robot_base.{k}"] for k in
         ("x_mm", "y_mm", "z_mm", "rx_deg", "ry_deg", "rz_deg")]  # fmt: skip
    return np.concatenate([(rig.rig_T_base - base)[:3, 3] * 1e3, turn]), np.array(u)


def test_a_session_that_cannot_be_made_is_refused_before_a_device_is_opened(
    tmp_path: Path,
) -> None:
    (tmp_path / "file").touch()
    for out, reason in (
        (tmp_path / "file" / "session", f"cannot be made in {tmp_path / 'file'}"),
        (tmp_path / "file", "exists; a session is recorded into a new folder"),
    ):
        said = verify("record", station(tmp_path, "station.toml"), "-o", out, "--for", "1s")
        assert reason in said.refusal
    path = tmp_path / "whole.toml"
    verify("run", path, "--new-station")
    path.write_text(path.read_text().replace('folder = "recordings"', 'folder = "file"'))
    for words in (["record", path], ["run", path, "-o", tmp_path / "report"]):
        said = verify(*words, "--for", "1s").refusal
        assert f"recording.folder: cannot be made in {tmp_path / 'file'}" in said


@pytest.mark.realtime
@pytest.mark.slow
@pytest.mark.long
def test_from_two_uncalibrated_cameras_to_a_report(tmp_path: Path) -> None:
    """Record, calibrate, register, watch, report, by `verify` alone; judged by the true world."""
    path, session = station(tmp_path, "station.toml"), tmp_path / "first"
    truth = simulate_session(library.load(str(tmp_path / "small.toml")))
    process = started(path, "-o", session, "--for", "9s")
    said = [json.loads(line) for line in process.stdout]
    process.stdout.close()
    assert process.wait() == 0, said
    assert said[-1]["type"] == "result"
    assert all(goal["value"] > 0 for goal in said[-1]["goals"]), said[-1]  # how far: the machine's
    table = tomllib.loads((session / "session.toml").read_text())
    assert (table["recording"], "rig" in table, "marker" in table) == ("closed", False, False)
    assert "t_host_s" in (session / "encoders.csv").read_text().splitlines()[0]

    (tmp_path / "boards.toml").write_text(BOARDS.format(pan=np.degrees(truth.pan[0]).tolist()))
    rig, registered, marker = (tmp_path / f"{n}.toml" for n in ("rig", "registered", "marker"))
    boards, report = tmp_path / "boards", tmp_path / "calibration"
    assert verify("simulate", tmp_path / "boards.toml", "-o", boards).status == 0
    assert verify("calibrate", "boards", boards, "-o", rig, "--report", report).status == 0

    assert "calibrate register" in verify("run", session, "--rig", rig).refusal
    words = ("-o", registered, "--marker", marker, "--report", tmp_path / "registration")
    done = verify("calibrate", "register", session, "--rig", rig, *words)
    assert done.status == 0, done.err
    error, u = base_error(truth, registered)
    assert (np.abs(error) < 3 * u).all(), (error, u)
    assert (u < [0.5, 0.5, 0.5, 0.1, 0.1, 0.1]).all()
    found = fiducials.read_marker(marker)[0]
    true = np.array([led.position_mm for led in truth.scenario.marker.led])
    near = np.linalg.norm(found.leds[:, None] * 1e3 - true, axis=2).min(axis=1)
    assert near.max() < 0.5

    again = verify("run", session, "--rig", registered, "--marker", marker, "-o", tmp_path / "a")
    assert again.status == 0, again.err
    watched = station(tmp_path, "watched.toml", 'rig = "registered.toml"\nmarker = "marker.toml"\n')
    command = [sys.executable, "-m", "verify", "run", str(watched), "--for", "4s", "-o", "out"]
    live = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert live.returncode == 0, live.stderr
    for summary in (read_summary(tmp_path / "a"), read_summary(tmp_path / "out")):
        joints = summary["joints"]
        assert [j["mean_error_deg"] is None for j in joints] == [True, *[False] * 4, True]
        for joint in joints[1:5]:  # healthy encoders
            assert abs(joint["mean_error_deg"]) < 1.5 * joint["expanded_uncertainty_deg"] < 0.3
    assert (tmp_path / "out" / "report.pdf").exists()


@pytest.mark.realtime
@pytest.mark.slow
def test_ctrl_c_keeps_the_recording_and_a_kill_leaves_one_that_opens(tmp_path: Path) -> None:
    path = station(tmp_path, "station.toml", 'rig = "sim"\n')
    for name, number, status in (("ended", signal.SIGINT, 0), ("killed", signal.SIGKILL, -9)):
        process = started(path, "-o", tmp_path / name)
        said = until(process, 8)
        process.send_signal(number)
        rest = [json.loads(line) for line in process.stdout]
        process.stdout.close()
        assert process.wait() == status
        opened = open_recording(tmp_path / name)
        assert len(opened) >= said["pairs"]
        assert opened.open is (status != 0)
        assert (rest[-1]["pairs"] == len(opened)) if status == 0 else True


@pytest.mark.realtime
@pytest.mark.slow
def test_devices_that_fail_and_a_full_disk_are_told_in_one_line(tmp_path: Path) -> None:
    silent = station(tmp_path, "silent.toml", events=event("encoder_silent"))
    refusal = verify("record", silent, "-o", tmp_path / "a", "--for", "2s").refusal
    assert "no reading (encoders:" in refusal
    blind = station(tmp_path, "blind.toml", events=event("camera_stalls", camera="left"))
    refusal = verify("record", blind, "-o", tmp_path / "b", "--for", "2s").refusal
    assert "no pair of pictures was recorded (left camera:" in refusal
    assert not (tmp_path / "b").exists()
    path = station(tmp_path, "station.toml")
    with mounted(tmp_path / "disk", "-o", "size=3m") as disk:
        refusal = verify("record", path, "-o", disk / "c", "--for", "30s").refusal
        assert "recording has stopped" in refusal
        assert "pairs are whole" in refusal
        assert len(open_recording(disk / "c", rig=_rig(tmp_path))) >= 1


@pytest.mark.realtime
@pytest.mark.slow
def test_sessions_of_a_clock_that_began_anew_are_all_named_beside_the_counts(
    tmp_path: Path,
) -> None:
    path = station(tmp_path, "reset.toml", events=event("encoder_reset", at_s=5.0))
    said = verify("record", path, "-o", tmp_path / "a", "--for", "6s").out
    assert f"readings in {tmp_path / 'a'}, {tmp_path / 'a-2'}" in said


def _rig(folder: Path) -> Path:
    """A rig for the small pictures: only their count matters here."""
    truth = simulate_session(library.load(str(folder / "small.toml")))
    io_rig.write(folder / "any.toml", truth.rig)
    return folder / "any.toml"


def test_what_cannot_be_recorded_is_refused_before_a_device_is_opened(tmp_path: Path) -> None:
    path = station(tmp_path, "station.toml")
    (tmp_path / "there").mkdir()
    assert "exists" in verify("record", path, "-o", tmp_path / "there").refusal
    assert "--for" in verify("record", path, "--for", "soon").refusal
    assert "none.toml" in verify("record", tmp_path / "none.toml").refusal
    encoders = 'encoders = { driver = "sim", rate_hz = 100.0 }\n'
    (tmp_path / "no.toml").write_text(path.read_text().replace(encoders, ""))
    assert "encoders: is missing" in verify("record", tmp_path / "no.toml").refusal
    lost = station(tmp_path, "lost.toml", 'rig = "rig.toml"\n')
    assert "leave the key out" in verify("record", lost).refusal
    assert "rig: is missing" in verify("run", path).refusal
    assert "--rig" in verify("run", path, "--rig", tmp_path / "rig.toml").refusal
    assert sorted(p.name for p in tmp_path.iterdir() if p.is_dir()) == ["there"]
    shutil.rmtree(tmp_path / "there")
