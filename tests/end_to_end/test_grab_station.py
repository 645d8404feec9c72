"""`verify grab STATION`: emulated devices on real ports, films of the simulated cell as cameras."""

import json
import os
import time
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from importlib import resources
from pathlib import Path

import cv2
import numpy as np
import pytest

import robots
from tests.verify.devices.bench import running, same_angles
from verify import marker_file, rig_file
from verify.commands import grabbing, grabbing_station
from verify.commands.grabbing import Wish
from verify.commands.grabbing_station import Ports, grab_on_station
from verify.emulators import trajectory
from verify.emulators.gripper import GripperEngine, GripperOptions
from verify.emulators.gripper_hand import contacts_of
from verify.emulators.melfa import ControllerOptions, MelfaEngine
from verify.emulators.melfa_arm import MelfaArm
from verify.errors import InputError
from verify.grab.melfa_motion import MelfaMover
from verify.grab.melfa_motion_settings import MotionSettings, MoveLimits
from verify.grab.motion_port import ExecuteRight, MoverState
from verify.recording.part import Facts, Part
from verify.recording.pictures import kind_of
from verify.records import StereoPair
from verify.sim.cell import World
from verify.sim.cell_scene import Cap, Scene
from verify.sim.cell_setup import ROBOT, SMALL, cell_setup

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
PLANS = Wish("blue", None, execute=False, auto=False, duration="20s")
GRABS = Wish("blue", None, execute=True, auto=True, duration="40s")


def film(folder: Path, seconds: float) -> None:
    """A cap that stands, and the arm at home."""
    setup = cell_setup(SMALL)
    pair = World(setup, Scene((Cap("blue", (0.47, 0.03)),), seed=1)).pair()
    assert pair is not None
    rows = (pair.left, pair.right)
    raws = tuple(bytes(cv2.imencode(".jpg", image)[1]) for image in rows)
    files = {
        "rig.toml": rig_file.encode(setup.rig),
        "marker.toml": marker_file.encode(setup.marker),
    }
    kinds = (kind_of(pair.left, raws[0]), kind_of(pair.right, raws[1]))
    part = Part(folder, Facts(ROBOT, 6, files, {}, turning=False), datetime.now(UTC), kinds)
    for frame in range(round(30 * seconds)):
        t = frame / 30
        one = StereoPair(frame, t, t, pair.pan_left, pair.pan_right, pair.left, pair.right)
        part.add_pair(one, (raws[0], raws[1]))
    part.close()


@contextmanager
def cell(folder: Path, seconds: float) -> Iterator[tuple[Path, str, str]]:
    """A station in a folder; gives its file, the controller's address and the gripper's."""
    film(folder / "film", seconds)
    cell = (resources.files("verify.sim") / "cell.toml").read_text()
    slower = cell.replace("share = 0.2", "share = 0.1")  # the driver stops a hand beyond 0.25 m/s
    (folder / "grab.toml").write_text(slower)
    assert isinstance(ARM, robots.DhArm)
    moved = MelfaArm(trajectory.load("hold", 6), 6, LIMITS, "command", ARM, True)
    fingers = GripperEngine(GripperOptions(0.5, contacts_of(30.0)))
    controller = MelfaEngine(moved, ControllerOptions())
    with running(controller) as at_arm, running(fingers) as at_fingers:
        go_home(at_arm.address)
        text = STATION.format(robot=ROBOT, port=at_arm.address)
        (folder / "station.toml").write_text(text)
        yield folder / "station.toml", at_arm.address, at_fingers.address


def go_home(address: str) -> None:
    settings = MotionSettings(address, "RV-3SD", pause=0.02)
    limits = MoveLimits(LIMITS, override=50, hand_speed=2.0)
    with MelfaMover(settings, same_angles(6), limits, ExecuteRight("test")) as mover:
        mover.take_controls()
        until(mover, MoverState.READY)
        mover.move_joints(cell_setup(SMALL).home)
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
    monkeypatch.setattr(grabbing, "STDIN", read)
    monkeypatch.setattr(grabbing_station, "STDIN", read)


@pytest.mark.slow
def test_a_cap_is_grasped_through_the_real_drivers(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with cell(tmp_path, 25.0) as (station, _, gripper):
        typed(monkeypatch, "")
        out = tmp_path / "out"
        assert grab_on_station(station, Ports(None, gripper), GRABS, out, force=False)
    summary = json.loads((out / "summary.json").read_text())
    assert (summary["state"], summary["released"]) == ("lifted", True)


@pytest.mark.slow
def test_a_wrong_confirmation_moves_nothing_and_writes_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(grabbing_station, "is_emulated_melfa", lambda *_, **__: False)
    with cell(tmp_path, 0.5) as (station, _, gripper):
        typed(monkeypatch, "yes\n")
        out = tmp_path / "out"
        with pytest.raises(InputError, match='"yes" was typed'):
            grab_on_station(station, Ports(None, gripper), GRABS, out, force=False)
        with pytest.raises(InputError, match="--gripper"):
            grab_on_station(station, Ports(None, None), GRABS, out, force=False)
        assert not out.exists()
        other = station.with_name("other.toml")
        other.write_text(station.read_text().replace('robot_type = "RV-3SD"', ""))
        with pytest.raises(InputError, match="robot_type"):
            grab_on_station(other, Ports(None, gripper), GRABS, out, force=False)
        nowhere = Ports(tmp_path / "nowhere.toml", gripper)
        with pytest.raises(InputError, match="nowhere"):
            grab_on_station(station, nowhere, GRABS, out, force=False)


@pytest.mark.slow
def test_without_execute_a_station_is_planned_for(tmp_path: Path) -> None:
    with cell(tmp_path, 8.0) as (station, _, _):
        out = tmp_path / "out"
        assert grab_on_station(station, Ports(None, None), PLANS, out, force=False)
    summary = json.loads((out / "summary.json").read_text())
    assert summary["plan"]["branch"]
    assert summary["state"] == "tracking"
