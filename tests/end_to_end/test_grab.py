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
from datetime import UTC, datetime
from pathlib import Path

import av
import cv2
import pytest

from reports.results import read
from tests.support.command import read_summary, verify
from tests.support.devices.bench import running
from tests.support.devices.melfa_mover import controller, go_home
from tests.support.grasp.cells import CELL, STATION
from verify.cli.grab import conduct
from verify.cli.grab import station as grab_station
from verify.cli.grab.conduct import GraspOptions, OperatorKeys
from verify.cli.grab.station import grab_on_station
from verify.devices.protocols import CapturedPair
from verify.errors import InputError
from verify.grasping.actuators import emulator_check
from verify.grasping.control.states import GraspEvent
from verify.io import fiducials, rig
from verify.io.session.session import open_session
from verify.live.recording.session import SessionFacts, SessionWriter
from verify.simulation.cell.cell import CellWorld
from verify.simulation.cell.scene import Cap, CellScene, draw_scene
from verify.simulation.cell.setup import ROBOT, SMALL_SIZE, cell_setup
from verify.simulation.emulators.gripper import GripperEngine, GripperOptions
from verify.simulation.emulators.hand import contact_positions
from verify.simulation.emulators.melfa import MelfaEngine
from verify.simulation.emulators.server import TimedMessage

SIMULATED = ("--sim", "--small", "--seed", "4")


def test_a_grab_leaves_a_film_a_session_and_a_report(tmp_path: Path) -> None:
    out = tmp_path / "out"
    done = verify("grab", *SIMULATED, "--execute", "--auto", "-o", out)
    assert done.status == 0
    assert "lifted: the object came along" in done.out
    summary = read_summary(out)
    assert (summary["state"], summary["released"]) == ("lifted", True)
    session = open_session(out / "session")
    assert session.warnings == ()
    with av.open(str(out / "grab.mp4")) as film:
        assert film.streams.video[0].frames == len(session) == summary["cycles"]
    page = (out / "report.html").read_text()
    assert 'src="data:video/mp4;base64,' in page
    for word in ("Grasped and lifted", "States over time", "CAMSHIFT", "Joint angles", "Margins"):
        assert word in page
    assert (out / "report.pdf").read_bytes().startswith(b"%PDF")
    results = read(out / "results")
    assert len(results.table("cycles")) == summary["cycles"]
    assert results.table("passages")["to_state"].iloc[-1] == "released"


def test_without_execute_the_plan_is_shown_and_nothing_moves(tmp_path: Path) -> None:
    pair = CellWorld(cell_setup(SMALL_SIZE), draw_scene(4)).pair()
    picture = pair.left.astype(int)
    rows, columns = ((picture[..., 0] - picture[..., 2]) > 60).nonzero()  # the blue cap
    x, y = columns.min() - 2, rows.min() - 2
    box = f"{x},{y},{columns.max() - x + 2},{rows.max() - y + 2}"
    out = tmp_path / "out"
    done = verify("grab", *SIMULATED, "--roi", box, "-o", out, "--json")
    assert done.status == 0
    lines = [json.loads(line) for line in done.out.splitlines()]
    assert [line["type"] for line in lines][-1] == "result"
    assert lines[-1]["summary"]["plan"]["branch"]
    results = read(out / "results")
    cycles = results.table("cycles")
    assert cycles["q1_deg"].std() < 0.01
    assert "q1_ordered_deg" not in cycles
    assert len(results.table("plan")) > 100
    assert "Planned; nothing was moved" in (out / "report.html").read_text()


def test_a_failed_grasp_has_exit_status_1(tmp_path: Path) -> None:
    words = ("--execute", "--auto", "--for", "0.3s", "-o", tmp_path / "out")
    done = verify("grab", *SIMULATED, *words)
    assert done.status == 1
    assert "idle" in done.out


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
    assert message in verify("grab", *words, "-o", tmp_path / "out").refusal
    assert not list(tmp_path.iterdir())


def test_a_folder_that_holds_something_is_refused_before_anything_runs(tmp_path: Path) -> None:
    (tmp_path / "mine").write_text("keep")
    assert "not empty" in verify("grab", "--sim", "-o", tmp_path).refusal
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
    done = verify("grab", *SIMULATED, "--execute", "--auto", "--turning", "-o", out)
    assert done.status == 0
    assert "holding-stale" in done.out
    pans = [math.degrees(pair.pan_left) for pair in open_session(out / "session").pairs()]
    stood = [pans[0], pans[0] + 3.0, pans[0] - 2.0]
    assert all(min(abs(pan - angle) for angle in stood) < 0.02 for pan in pans)
    assert all(min(abs(pan - angle) for pan in pans) < 0.02 for angle in stood)


PLANS = GraspOptions("blue", None, execute=False, auto=False, duration=20.0)
GRABS = GraspOptions("blue", None, execute=True, auto=True, duration=40.0)


def film(folder: Path, seconds: float) -> None:
    """A cap that stands, and the arm at home."""
    setup = cell_setup(SMALL_SIZE)
    pair = CellWorld(setup, CellScene((Cap("blue", (0.47, 0.03)),), seed=1)).pair()
    rows = (pair.left, pair.right)
    raws = tuple(bytes(cv2.imencode(".jpg", image)[1]) for image in rows)
    files = {"rig.toml": rig.encode(setup.rig)}
    files["marker.toml"] = fiducials.encode_marker(setup.marker)
    facts = SessionFacts(ROBOT, 6, files, {}, turning=False)
    pans = (pair.pan_left, pair.pan_right)
    pairs = [
        CapturedPair(frame, frame / 30, frame / 30, *pans, *rows, (True, True), *raws)
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
    slower = CELL.replace("share = 0.2", "share = 0.1")  # the driver stops a hand beyond 0.25 m/s
    (folder / "grab.toml").write_text(slower)
    fingers = GripperEngine(GripperOptions(0.5, contact_positions(30.0)))
    with running(controller(follows="command")) as at_arm, running(fingers) as at_fingers:
        go_home(at_arm, cell_setup(SMALL_SIZE).home)
        text = STATION.format(robot=ROBOT, port=at_arm.address)
        (folder / "station.toml").write_text(text)
        yield folder / "station.toml", at_arm.address, at_fingers.address


def grasp(
    station: Path, gripper: str | None, options: GraspOptions, cell: Path | None = None
) -> bool:
    """Grasp with a station's devices; what it writes goes beside the station."""
    out = station.parent / "out"
    return grab_on_station(station, cell, gripper, options, out, force=False)


def typed(monkeypatch: pytest.MonkeyPatch, text: str) -> None:
    """Have this on standard input, which stays open."""
    read, write = os.pipe()
    os.write(write, text.encode())
    monkeypatch.setattr(conduct, "STDIN", read)
    monkeypatch.setattr(grab_station, "STDIN", read)


@pytest.mark.realtime
def test_a_grasp_goes_through_the_real_drivers_and_emulators_need_no_confirmation(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(grab_station, "_read_line", lambda: pytest.fail("nobody is to be asked"))
    with cell(tmp_path, 25.0) as (station, _, gripper):
        typed(monkeypatch, "")
        assert not grasp(station, gripper, GRABS)  # the film's cap does not come along
    summary = read_summary(tmp_path / "out")
    assert summary["execute"]
    assert (summary["state"], summary["released"]) == ("lifted", True)


@pytest.mark.realtime
@pytest.mark.slow
def test_a_controller_that_falls_silent_has_not_given_its_controls_back(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    with cell(tmp_path, 8.0) as (station, _, gripper):
        typed(monkeypatch, "")
        step, quiet = MelfaEngine.step, time.monotonic() + 4.0

        def silent(engine: MelfaEngine, t: float, received: bytes) -> list[TimedMessage]:
            answers = step(engine, t, received)
            return answers if time.monotonic() < quiet else []

        monkeypatch.setattr(MelfaEngine, "step", silent)
        assert not grasp(station, gripper, GRABS)
    summary = read_summary(tmp_path / "out")
    assert not summary["released"]
    said = "".join(capsys.readouterr())  # whatever the tests before have set
    assert "controls were NOT given back" in said
    assert "controls returned. Use the emergency stop if it moves" in said


@pytest.mark.realtime
def test_a_grasp_that_lacks_something_moves_nothing_and_writes_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(grab_station, "is_emulated_melfa", lambda *_, **__: False)
    with cell(tmp_path, 0.5) as (station, _, gripper):
        with pytest.raises(InputError, match="--gripper"):
            grasp(station, None, GRABS)
        other = station.with_name("other.toml")
        other.write_text(station.read_text().replace('robot_type = "RV-3SD"', ""))
        with pytest.raises(InputError, match="robot_type"):
            grasp(other, gripper, GRABS)
        with pytest.raises(InputError, match="nowhere"):
            grasp(station, gripper, GRABS, cell=tmp_path / "nowhere.toml")
    assert not (tmp_path / "out").exists()


def test_without_execute_a_station_is_planned_for(tmp_path: Path) -> None:
    with cell(tmp_path, 8.0) as (station, _, _):
        assert grasp(station, None, PLANS)
    summary = read_summary(tmp_path / "out")
    assert summary["plan"]["branch"]
    assert summary["state"] == "tracking"


OTHER = '[encoders]\ndriver = "labenc"\nport = "/dev/null"\nresolution_deg = 0.01\n'


@pytest.mark.parametrize(
    ("station", "cell", "message"),
    [
        (STATION, re.sub(r"(?ms)^\[gripper\].*?(?=^\[)", "", CELL), "gripper"),
        (STATION.split("[encoders]")[0] + OTHER, CELL,
         'station.toml, encoders.driver: is "labenc"; only a MELFA controller can be'),
    ],
    ids=["no gripper", "no MELFA"],
)  # fmt: skip
def test_a_cell_that_cannot_grasp_is_refused(
    station: str, cell: str, message: str, tmp_path: Path
) -> None:
    film(tmp_path / "film", 0.1)
    (tmp_path / "station.toml").write_text(station.format(robot=ROBOT, port="tcp:127.0.0.1:9"))
    (tmp_path / "grab.toml").write_text(cell)
    words = ("--execute", "--gripper", "/dev/null", "-o", tmp_path / "out")
    assert message in verify("grab", tmp_path / "station.toml", *words).refusal
    assert not (tmp_path / "out").exists()


@pytest.mark.realtime
@pytest.mark.parametrize("real", ["controller", "gripper"])
def test_one_real_device_requires_confirmation(
    real: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(emulator_check, "TIMEOUT", 0.3)
    requests: list[bytes] = []
    carry_out = GripperEngine._carry_out

    def answer(self: GripperEngine, body: bytes, t: float) -> bytes:
        requests.append(body)
        unknown = b"\x63" + body[1:] if real == "gripper" and body[0] == 43 else body
        return carry_out(self, unknown, t)

    monkeypatch.setattr(GripperEngine, "_carry_out", answer)
    if real == "controller":
        identity = (
            "3F;3F;7,0;3,5,A,1E,32,46,64;MB5;PRM;RV-3SD;CRn-7xx;MELFA;09-01-20;N8a;ENG;;1;1;8;"
        )
        monkeypatch.setattr(MelfaEngine, "_identity", lambda *_: identity)
    typed(monkeypatch, "yes\n")
    with (
        cell(tmp_path, 0.5) as (station, controller, gripper),
        pytest.raises(InputError, match=f'"yes" was typed.*"RV-3SD {controller}" is expected'),
    ):
        grasp(station, gripper, GRABS)
    # beside a real controller the gripper is asked nothing before somebody has confirmed
    assert requests == ([] if real == "controller" else requests[:1])
    assert not (tmp_path / "out").exists()
