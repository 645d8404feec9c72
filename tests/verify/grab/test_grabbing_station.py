"""Who has to confirm: an operator beside a real controller or gripper, nobody beside emulators."""

import json
from dataclasses import replace
from importlib import resources
from pathlib import Path

import pytest

from tests.end_to_end import test_grab_station as bench
from tests.end_to_end.command import verify
from verify.commands import grabbing_station
from verify.commands.grabbing_station import Ports, grab_on_station
from verify.emulators.gripper import GripperEngine
from verify.emulators.melfa import MelfaEngine
from verify.errors import InputError
from verify.grab import emulated
from verify.sim.cell_setup import ROBOT

SHORT = replace(bench.GRABS, duration="1s")


def refused(folder: Path, station: str, cell: str) -> str:
    """Order a grab with these files; gives the one line of its refusal."""
    bench.film(folder / "film", 0.1)
    (folder / "station.toml").write_text(station)
    (folder / "grab.toml").write_text(cell)
    words = ("grab", folder / "station.toml", "--execute", "--gripper", "/dev/null")
    ended = verify(*words, "-o", folder / "out")
    assert ended.status == 2
    assert not (folder / "out").exists()
    assert ended.err.count("\n") == 1, ended.err
    return ended.err


def test_a_cell_without_a_gripper_is_refused(tmp_path: Path) -> None:
    whole = (resources.files("verify.sim") / "cell.toml").read_text()
    head, tail = whole.split("[gripper]")
    without = head + tail[tail.index("\n[") :]
    station = bench.STATION.format(robot=ROBOT, port="tcp:127.0.0.1:9")
    said = refused(tmp_path, station, without)
    assert "grab.toml" in said
    assert "gripper" in said


def test_a_robot_that_is_no_melfa_is_refused(tmp_path: Path) -> None:
    whole = (resources.files("verify.sim") / "cell.toml").read_text()
    head = bench.STATION.split("[encoders]")[0].format(robot=ROBOT)
    other = 'driver = "labenc"\nport = "/dev/null"\nresolution_deg = 0.01\n'
    said = refused(tmp_path, f"{head}[encoders]\n{other}", whole)
    assert 'station.toml, encoders.driver: is "labenc"; only a MELFA controller can be' in said


@pytest.mark.slow
def test_emulators_need_execute_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(grabbing_station, "_line", lambda: pytest.fail("nobody is to be asked"))
    bench.typed(monkeypatch, "")
    with bench.cell(tmp_path, 2.5) as (station, _, gripper):
        grab_on_station(station, Ports(None, gripper), SHORT, tmp_path / "out", force=False)
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert summary["execute"]
    assert summary["state"] in ("following", "tracking", "approaching", "searching", "idle")
    assert summary["released"]


@pytest.mark.slow
@pytest.mark.parametrize("real", ["controller", "gripper"])
def test_one_real_device_is_enough_to_be_asked(
    real: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(emulated, "PATIENCE", 0.3)
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
    bench.typed(monkeypatch, "yes\n")
    with (
        bench.cell(tmp_path, 0.5) as (station, controller, gripper),
        pytest.raises(InputError, match=f'"RV-3SD {controller}" is expected'),
    ):
        grab_on_station(station, Ports(None, gripper), SHORT, tmp_path / "out", force=False)
    # beside a real controller the gripper is asked nothing before somebody has confirmed
    assert asked == ([] if real == "controller" else asked[:1])
    assert not (tmp_path / "out").exists()
