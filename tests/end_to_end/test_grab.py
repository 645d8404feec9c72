"""`verify grab --sim` as a user runs it: exit status, files, messages.

`verify grab STATION`: emulated devices on real ports, films of the simulated cell as cameras.

Who has to confirm: an operator beside a real controller or gripper, nobody beside emulators.
"""

import json
import math
import os
import re
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from datetime import UTC, datetime
from importlib import resources
from pathlib import Path

import av
import cv2
import numpy as np
import pytest
import typer
from typer.testing import CliRunner

import robots
from reports.results import read
from tests.support.command import verify
from tests.support.devices.bench import running, same_angles
from verify.cli.grab import conduct
from verify.cli.grab import station as grab_station
from verify.cli.grab import station as grabbing_station
from verify.cli.grab.conduct import GraspOptions, OperatorKeys
from verify.cli.grab.grab import grab
from verify.cli.grab.station import ActuatorPorts, grab_on_station
from verify.cli.terminal import terminal
from verify.devices.protocols import CapturedPair
from verify.errors import InputError
from verify.grasping.actuators import emulator_check
from verify.grasping.actuators.melfa.mover import MelfaMover
from verify.grasping.actuators.melfa.orders import MotionSettings, MoveLimits
from verify.grasping.actuators.protocols import ExecutePermission, MoverState
from verify.grasping.control.states import GraspEvent
from verify.io import fiducials, rig
from verify.io.session.session import open_session
from verify.live.recording.session import SessionFacts, SessionWriter
from verify.simulation.cell.cell import CellWorld
from verify.simulation.cell.scene import Cap, CellScene, draw_scene
from verify.simulation.cell.setup import ROBOT, SMALL_SIZE, cell_setup
from verify.simulation.emulators import trajectory
from verify.simulation.emulators.arm import MelfaArm
from verify.simulation.emulators.gripper import GripperEngine, GripperOptions
from verify.simulation.emulators.hand import contact_positions
from verify.simulation.emulators.melfa import ControllerOptions, MelfaEngine

APP = typer.Typer()
APP.command()(grab)
APP.command(name="other")(lambda: None)  # with two commands a name is needed, as in `verify`


def verify_grab(*words: str) -> tuple[int, str]:
    found = CliRunner().invoke(APP, ["grab", *words], standalone_mode=False)
    if found.exception is not None:
        raise found.exception
    return found.return_value, found.output


def test_a_grab_leaves_a_film_a_session_and_a_report(tmp_path: Path) -> None:
    out = tmp_path / "out"
    words = ("--sim", "--execute", "--auto", "--small", "--seed", "4", "-o", str(out))
    status, message = verify_grab(*words)
    assert status == 0
    assert "lifted: the object came along" in message
    summary = json.loads((out / "summary.json").read_text())
    assert (summary["state"], summary["released"]) == ("lifted", True)
    session = open_session(out / "session")
    assert session.warnings == ()
    with av.open(str(out / "grab.mp4")) as film:
        assert film.streams.video[0].frames == len(session) == summary["cycles"]
    page = (out / "report.html").read_text()
    for word in ("Grasped and lifted", "States over time", "CAMSHIFT", "Joint angles", "Margins"):
        assert word in page
    assert (out / "report.pdf").read_bytes().startswith(b"%PDF")
    results = read(out / "results")
    assert len(results.table("cycles")) == summary["cycles"]
    assert results.table("passages")["to_state"].iloc[-1] == "released"


def test_without_execute_the_plan_is_shown_and_nothing_moves(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(terminal, "as_json", True)
    pair = CellWorld(cell_setup(SMALL_SIZE), draw_scene(4)).pair()
    assert pair is not None
    picture = pair.left.astype(int)
    rows, columns = ((picture[..., 0] - picture[..., 2]) > 60).nonzero()  # the blue cap
    x, y = columns.min() - 2, rows.min() - 2
    box = f"{x},{y},{columns.max() - x + 2},{rows.max() - y + 2}"
    out = tmp_path / "out"
    status, message = verify_grab("--sim", "--small", "--seed", "4", "--roi", box, "-o", str(out))
    assert status == 0
    lines = [json.loads(line) for line in message.splitlines()]
    assert [line["type"] for line in lines][-1] == "result"
    assert lines[-1]["summary"]["plan"]["branch"]
    results = read(out / "results")
    cycles = results.table("cycles")
    assert cycles["q1_deg"].std() < 0.01
    assert "q1_ordered_deg" not in cycles
    assert len(results.table("plan")) > 100
    assert "Planned; nothing was moved" in (out / "report.html").read_text()


def test_a_failed_grasp_has_exit_status_1(tmp_path: Path) -> None:
    out = tmp_path / "out"
    words = ("--sim", "--execute", "--auto", "--small", "--for", "0.3s", "-o", str(out))
    status, message = verify_grab(*words)
    assert status == 1
    assert "idle" in message


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("--sim", "--target", "mauve"), "mauve"),
        (("--sim", "--roi", "3,4"), "--roi"),
        (("--sim", "--for", "soon"), "--for"),
        ((), "--sim"),
        (("--sim", "--auto"), "--execute"),
        (("--sim", "--target", "red", "--roi", "1,1,9,9"), "not both"),
    ],
)
def test_bad_input_takes_one_line_and_leaves_nothing(
    tmp_path: Path, words: tuple[str, ...], message: str
) -> None:
    out = tmp_path / "out"
    with pytest.raises((InputError, Exception), match=re.escape(message)):
        verify_grab(*words, "-o", str(out))
    assert not out.exists()


def test_a_folder_that_holds_something_is_refused_before_anything_runs(tmp_path: Path) -> None:
    (tmp_path / "mine").write_text("keep")
    with pytest.raises(InputError, match="not empty"):
        verify_grab("--sim", "-o", str(tmp_path))
    assert [p.name for p in tmp_path.iterdir()] == ["mine"]


def test_keys_become_orders_and_others_are_named(capsys: pytest.CaptureFixture[str]) -> None:
    read, write = os.pipe()
    os.write(write, b"G\nx\nh\nq\n")
    os.close(write)
    keys = OperatorKeys(read)
    end = time.monotonic() + 5.0
    while not keys.quit and time.monotonic() < end:
        time.sleep(0.005)
    assert keys.quit
    assert list(keys.pressed()) == [GraspEvent.GRAB, GraspEvent.HOLD]
    assert keys.pressed() == []
    assert '"x" is no key' in capsys.readouterr().err


@pytest.mark.slow
def test_turning_bases_are_recorded_as_they_stood(tmp_path: Path) -> None:
    out = tmp_path / "out"
    words = ("--sim", "--execute", "--auto", "--small", "--seed", "4", "--turning", "-o", str(out))
    status, message = verify_grab(*words)
    assert status == 0
    assert "holding-stale" in message
    pans = [math.degrees(pair.pan_left) for pair in open_session(out / "session").pairs()]
    stood = [pans[0], pans[0] + 3.0, pans[0] - 2.0]
    assert all(min(abs(pan - angle) for angle in stood) < 0.02 for pan in pans)
    assert all(min(abs(pan - angle) for pan in pans) < 0.02 for angle in stood)


ARM = robots.load(ROBOT)
LIMITS = np.column_stack([ARM.lower, ARM.upper])
STATION = """
format = 1
robot = "{robot}"
rig = "film/rig.toml"
marker = "film/marker.toml"

[left]
source = "film/left.mkv"
rate_hz = 30.0

[right]
source = "film/right.mkv"
rate_hz = 30.0

[encoders]
driver = "melfa"
port = "{port}"
robot_type = "RV-3SD"
pause_ms = 20.0
"""
PLANS = GraspOptions("blue", None, execute=False, auto=False, duration=20.0)
GRABS = GraspOptions("blue", None, execute=True, auto=True, duration=40.0)


def film(folder: Path, seconds: float) -> None:
    """A cap that stands, and the arm at home."""
    setup = cell_setup(SMALL_SIZE)
    pair = CellWorld(setup, CellScene((Cap("blue", (0.47, 0.03)),), seed=1)).pair()
    assert pair is not None
    rows = (pair.left, pair.right)
    raws = tuple(bytes(cv2.imencode(".jpg", image)[1]) for image in rows)
    files = {
        "rig.toml": rig.encode(setup.rig),
        "marker.toml": fiducials.encode_marker(setup.marker),
    }
    facts = SessionFacts(ROBOT, 6, files, {}, turning=False)
    pans = (pair.pan_left, pair.pan_right)
    pairs = [
        CapturedPair(frame, frame / 30, frame / 30, *pans, pair.left, pair.right, *raws)
        for frame in range(round(30 * seconds))
    ]
    part = SessionWriter(folder, facts, datetime.now(UTC), pairs[0])
    for one in pairs:
        part.add_pair(one)
    part.close()


@contextmanager
def cell(folder: Path, seconds: float) -> Iterator[tuple[Path, str, str]]:
    """A station in a folder; gives its file, the controller's address and the gripper's."""
    film(folder / "film", seconds)
    cell = (resources.files("verify.simulation") / "cell.toml").read_text()
    slower = cell.replace("share = 0.2", "share = 0.1")  # the driver stops a hand beyond 0.25 m/s
    (folder / "grab.toml").write_text(slower)
    assert isinstance(ARM, robots.DhArm)
    moved = MelfaArm(trajectory.load("hold", 6), 6, LIMITS, "command", ARM, True)
    fingers = GripperEngine(GripperOptions(0.5, contact_positions(30.0)))
    controller = MelfaEngine(moved, ControllerOptions())
    with running(controller) as at_arm, running(fingers) as at_fingers:
        go_home(at_arm.address)
        text = STATION.format(robot=ROBOT, port=at_arm.address)
        (folder / "station.toml").write_text(text)
        yield folder / "station.toml", at_arm.address, at_fingers.address


def go_home(address: str) -> None:
    settings = MotionSettings(address, "RV-3SD", pause=0.02)
    limits = MoveLimits(LIMITS, override=50, hand_speed=2.0)
    with MelfaMover(settings, same_angles(6), limits, ExecutePermission("test")) as mover:
        mover.take_controls()
        until(mover, MoverState.READY)
        mover.move_joints(cell_setup(SMALL_SIZE).home)
        until(mover, MoverState.ARRIVED)


def until(mover: MelfaMover, state: MoverState) -> None:
    end = time.monotonic() + 20.0
    while (status := mover.step()).state is not state:
        assert time.monotonic() < end, status
        time.sleep(0.01)


def typed(monkeypatch: pytest.MonkeyPatch, text: str) -> None:
    """Have this on standard input, which stays open."""
    read, write = os.pipe()
    os.write(write, text.encode())
    monkeypatch.setattr(conduct, "STDIN", read)
    monkeypatch.setattr(grab_station, "STDIN", read)


@pytest.mark.realtime
def test_a_cap_is_grasped_through_the_real_drivers(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with cell(tmp_path, 25.0) as (station, _, gripper):
        typed(monkeypatch, "")
        out = tmp_path / "out"
        assert grab_on_station(station, ActuatorPorts(None, gripper), GRABS, out, force=False)
    summary = json.loads((out / "summary.json").read_text())
    assert (summary["state"], summary["released"]) == ("lifted", True)


@pytest.mark.realtime
def test_a_wrong_confirmation_moves_nothing_and_writes_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(grab_station, "is_emulated_melfa", lambda *_, **__: False)
    with cell(tmp_path, 0.5) as (station, _, gripper):
        typed(monkeypatch, "yes\n")
        out = tmp_path / "out"
        with pytest.raises(InputError, match='"yes" was typed'):
            grab_on_station(station, ActuatorPorts(None, gripper), GRABS, out, force=False)
        with pytest.raises(InputError, match="--gripper"):
            grab_on_station(station, ActuatorPorts(None, None), GRABS, out, force=False)
        assert not out.exists()
        other = station.with_name("other.toml")
        other.write_text(station.read_text().replace('robot_type = "RV-3SD"', ""))
        with pytest.raises(InputError, match="robot_type"):
            grab_on_station(other, ActuatorPorts(None, gripper), GRABS, out, force=False)
        nowhere = ActuatorPorts(tmp_path / "nowhere.toml", gripper)
        with pytest.raises(InputError, match="nowhere"):
            grab_on_station(station, nowhere, GRABS, out, force=False)


def test_without_execute_a_station_is_planned_for(tmp_path: Path) -> None:
    with cell(tmp_path, 8.0) as (station, _, _):
        out = tmp_path / "out"
        assert grab_on_station(station, ActuatorPorts(None, None), PLANS, out, force=False)
    summary = json.loads((out / "summary.json").read_text())
    assert summary["plan"]["branch"]
    assert summary["state"] == "tracking"


SHORT = replace(GRABS, duration=1.0)


def refused(folder: Path, station: str, cell: str) -> str:
    """Order a grab with these files; gives the one line of its refusal."""
    film(folder / "film", 0.1)
    (folder / "station.toml").write_text(station)
    (folder / "grab.toml").write_text(cell)
    words = ("grab", folder / "station.toml", "--execute", "--gripper", "/dev/null")
    ended = verify(*words, "-o", folder / "out")
    assert ended.status == 2
    assert not (folder / "out").exists()
    assert ended.err.count("\n") == 1, ended.err
    return ended.err


def test_a_cell_without_a_gripper_is_refused(tmp_path: Path) -> None:
    whole = (resources.files("verify.simulation") / "cell.toml").read_text()
    head, tail = whole.split("[gripper]")
    without = head + tail[tail.index("\n[") :]
    station = STATION.format(robot=ROBOT, port="tcp:127.0.0.1:9")
    message = refused(tmp_path, station, without)
    assert "grab.toml" in message
    assert "gripper" in message


def test_a_robot_that_is_no_melfa_is_refused(tmp_path: Path) -> None:
    whole = (resources.files("verify.simulation") / "cell.toml").read_text()
    head = STATION.split("[encoders]")[0].format(robot=ROBOT)
    other = 'driver = "labenc"\nport = "/dev/null"\nresolution_deg = 0.01\n'
    message = refused(tmp_path, f"{head}[encoders]\n{other}", whole)
    assert 'station.toml, encoders.driver: is "labenc"; only a MELFA controller can be' in message


@pytest.mark.realtime
def test_emulators_need_execute_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        grabbing_station, "_read_line", lambda: pytest.fail("nobody is to be asked")
    )
    typed(monkeypatch, "")
    with cell(tmp_path, 2.5) as (station, _, gripper):
        grab_on_station(station, ActuatorPorts(None, gripper), SHORT, tmp_path / "out", force=False)
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert summary["execute"]
    assert summary["state"] in ("following", "tracking", "approaching", "searching", "idle")
    assert summary["released"]


@pytest.mark.realtime
@pytest.mark.parametrize("real", ["controller", "gripper"])
def test_one_real_device_requires_confirmation(
    real: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(emulator_check, "TIMEOUT", 0.3)
    asked: list[bytes] = []
    carry_out = GripperEngine._carry_out

    def known(self: GripperEngine, body: bytes, t: float) -> bytes:
        asked.append(body)
        unknown = b"\x63" + body[1:] if real == "gripper" and body[0] == 43 else body
        return carry_out(self, unknown, t)

    monkeypatch.setattr(GripperEngine, "_carry_out", known)
    if real == "controller":
        identity = (
            "3F;3F;7,0;3,5,A,1E,32,46,64;MB5;PRM;RV-3SD;CRn-7xx;MELFA;09-01-20;N8a;ENG;;1;1;8;"
        )
        monkeypatch.setattr(MelfaEngine, "_identity", lambda *_: identity)
    typed(monkeypatch, "yes\n")
    with (
        cell(tmp_path, 0.5) as (station, controller, gripper),
        pytest.raises(InputError, match=f'"RV-3SD {controller}" is expected'),
    ):
        grab_on_station(station, ActuatorPorts(None, gripper), SHORT, tmp_path / "out", force=False)
    # beside a real controller the gripper is asked nothing before somebody has confirmed
    assert asked == ([] if real == "controller" else asked[:1])
    assert not (tmp_path / "out").exists()
