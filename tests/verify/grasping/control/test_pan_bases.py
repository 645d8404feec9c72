"""Cameras on turning bases: pictures count with the angles of their instant, or not at all."""

import time
from collections import deque
from collections.abc import Callable
from dataclasses import replace
from typing import TypeVar

import numpy as np
import pytest

from robots.transforms import carry, invert
from tests.support.grasp.cells import grip_error, kept_limits, quick_cell
from tests.support.grasp.monitor import MonitoredRun, monitored
from tests.support.scene import off_axis
from verify.cli.grab.station import LivePairs
from verify.cli.terminal import terminal
from verify.devices.protocols import CameraFrame, DeviceState, PanReading
from verify.grasping.actuators.protocols import ExecutePermission
from verify.grasping.control.aim import LoopCycle
from verify.grasping.control.run import GraspOutcome, StopConditions, run
from verify.grasping.control.states import GraspState
from verify.grasping.planning.workspace import workspace_with_cameras
from verify.live.buffers import MAX_PAN_AGE, PanBuffer
from verify.simulation.cell.grab import CellMode, cell_grab
from verify.simulation.cell.scene import Cap, CellScene, PanTurn
from verify.simulation.cell.setup import SMALL_SIZE, cell_setup

SETUP = quick_cell(turning=True)
CAP = (Cap("blue", (0.47, 0.03)),)
ENDS = StopConditions(duration=20.0, patience=1.0)


class Unturned(PanBuffer):
    """What a grab would believe that does not ask how the bases stand."""

    def at(self, t: float) -> tuple[float, float] | None:  # noqa: ARG002
        return SETUP.rig.left.pan, SETUP.rig.right.pan


def seen(
    *turns: PanTurn, bases: PanBuffer, moves: bool = False
) -> tuple[MonitoredRun, GraspOutcome, list[LoopCycle]]:
    permission = ExecutePermission("test") if moves else None
    scene = CellScene(CAP, turns=turns, seed=1)
    made = monitored(
        cell_grab(SETUP, scene, permission=permission, mode=CellMode(auto=True), bases=bases)
    )
    cycles: list[LoopCycle] = []
    ends = ENDS if moves else StopConditions(duration=2.0, patience=2.0, planned=False)
    return made, run(made.loop, made.source, ends, cycles.append), cycles


def where(cycles: list[LoopCycle]) -> np.ndarray:
    """The target's place in the base as it was last seen."""
    known = next(c.target for c in reversed(cycles) if c.target is not None and c.target.tracked)
    return known.thing.position


def test_a_target_stays_where_it_is_when_the_cameras_turn() -> None:
    made, _, cycles = seen(PanTurn(0.6, np.deg2rad(3.0), 0.2), bases=PanBuffer())
    place = made.world.cap(0, 0.0)
    assert np.linalg.norm(where(cycles) - place[:3, 3]) < 3e-3
    skipped = [c.t for c in cycles if c.pair is None]
    assert min(skipped) == pytest.approx(0.6, abs=0.04)
    assert max(skipped) == pytest.approx(0.9, abs=0.04)  # the base stands, and has settled
    pans = [c.pair.pan_left for c in cycles if c.pair is not None]
    assert np.ptp(pans) == pytest.approx(np.deg2rad(3.0), abs=3e-4)
    _, _, cycles = seen(PanTurn(0.6, np.deg2rad(3.0), 0.2), bases=Unturned())
    known = [c.target.thing.position for c in cycles if c.target is not None]
    assert max(np.linalg.norm(p - place[:3, 3]) for p in known) > 0.02


@pytest.mark.slow
def test_the_arm_waits_while_the_bases_turn_and_grasps_with_the_new_angles() -> None:
    made, ended, _ = seen(
        PanTurn(0.9, np.deg2rad(3.0), 0.25), PanTurn(3.0, np.deg2rad(-2.0), 0.1),
        bases=PanBuffer(), moves=True,
    )  # fmt: skip
    assert ended.state is GraspState.LIFTED
    assert GraspState.HOLDING_STALE in {passage.target for passage in ended.passages}
    found = made.loop.aim.planned
    assert found.thing.offset.used  # the LEDs too were measured with the turned cameras
    assert grip_error(made) < 1e-3
    assert kept_limits(made)


@pytest.mark.slow
def test_a_long_turn_in_mid_descent_holds_and_a_person_decides() -> None:
    made, ended, _ = seen(PanTurn(2.6, np.deg2rad(8.0), 0.8), bases=PanBuffer(), moves=True)
    assert ended.state is GraspState.HOLDING_OPERATOR
    assert [p.target for p in ended.passages if p.source is GraspState.APPROACHING] == [
        GraspState.HOLDING_STALE
    ]
    assert ended.released
    assert made.world.held is None


T = TypeVar("T")


class Given:
    """A device that gives what it was given, then nothing."""

    def __init__(self, *things: object) -> None:
        self.things, self.closed = deque(things), False

    def state(self) -> DeviceState:
        return DeviceState(not self.closed, None, 0, {}, "gives what it was given")

    def close(self) -> None:
        self.closed = True


class GivenCamera(Given):
    def read(self) -> CameraFrame | None:
        return self.things.popleft() if self.things else None  # type: ignore[return-value]


class GivenPan(Given):
    def read(self) -> list[PanReading]:
        return [self.things.popleft()] if self.things else []  # type: ignore[list-item]


def frame(t: float) -> CameraFrame:
    return CameraFrame(t, 1e-3, np.zeros((4, 4, 3), np.uint8), raw=None, sequence=0)


def soon(look: Callable[[], T | None]) -> T:
    end = time.monotonic() + 5.0
    while (found := look()) is None:
        assert time.monotonic() < end
        time.sleep(0.002)
    return found


def reading(t: float, left: float, *, moving: bool = False) -> PanReading:
    return PanReading(t, t, 5e-4, 0, np.array([left, -left]), moving)


@pytest.mark.realtime
def test_a_stations_pairs_carry_the_angles_of_their_instant_and_none_of_a_turning_base() -> None:
    pan = GivenPan(*(reading(101.0 + 0.01 * i, 0.02) for i in range(60)))
    cameras = (GivenCamera(), GivenCamera())
    live = LivePairs(cameras, pan, SETUP.rig, 30.0, 100.0)  # type: ignore[arg-type]
    try:
        assert soon(lambda: None if pan.things else True)
        for camera in cameras:
            camera.things.append(frame(101.5))
        pair = soon(live.pair)
        assert (pair.pan_left, pair.pan_right) == (0.02, -0.02)
        assert pair.t_left == pytest.approx(1.5)
        pan.things.extend(reading(101.6 + 0.01 * i, 0.03, moving=True) for i in range(20))
        pan.things.extend(reading(101.8 + 0.01 * i, 0.05) for i in range(30))
        assert soon(lambda: None if pan.things else True)
        for t in (101.7, 102.0):  # the base turns; it stands again
            for camera in cameras:
                camera.things.append(frame(t))
        pair = soon(live.pair)
        assert pair.t_left == pytest.approx(2.0)
        assert pair.pan_left == 0.05
        for camera in cameras:  # nobody has said for long how they stand
            camera.things.append(frame(102.2 + MAX_PAN_AGE))
        assert soon(lambda: None if any(c.things for c in cameras) else True)
        time.sleep(0.1)  # as long as a camera's thread waits for word of the bases, and more
        assert live.pair() is None
    finally:
        live.close()
    assert pan.closed
    assert all(camera.closed for camera in cameras)


def test_the_arm_keeps_away_from_every_place_that_a_turning_camera_can_have() -> None:
    rig = SETUP.rig
    moved = replace(rig, left=off_axis(rig.left), right=off_axis(rig.right))
    arm, cell = SETUP.workspace.arm, cell_setup(SMALL_SIZE).cell
    turning = workspace_with_cameras(arm, cell, moved, turning=True)
    q = np.random.default_rng(3).uniform(arm.lower, arm.upper, (40, arm.dof))
    kept = turning.margins(q)
    names = [i for i, name in enumerate(turning.names) if "camera" in name]
    nearest = np.full(kept.shape, np.inf)
    for pan in np.linspace(-np.pi, np.pi, 90):
        placed = [carry(invert(rig.rig_T_base), c.rig_T_camera(pan)[:3, 3])
                  for c in (moved.left, moved.right)]  # fmt: skip
        fixed = replace(turning, cell=cell, cameras=np.array(placed))
        nearest = np.minimum(nearest, fixed.margins(q))
    assert (kept[:, names] <= nearest[:, names] + 1e-9).all()
    assert (kept[:, names] >= nearest[:, names] - 2 * np.hypot(0.03, 0.04) - 1e-3).all()


class FailingCamera(GivenCamera):
    """A camera whose driver fails now and then."""

    def read(self) -> CameraFrame | None:
        if self.things and isinstance(self.things[0], Exception):
            raise self.things.popleft()
        return super().read()


@pytest.mark.realtime
def test_reads_that_fail_are_said_once_and_again_when_they_recover(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    said: list[str] = []
    monkeypatch.setattr(type(terminal), "warn", lambda _, *words: said.extend(words))
    failing = FailingCamera(*(OSError("no device") for _ in range(20)), frame(101.0))
    cameras = (failing, GivenCamera(frame(101.0)))
    live = LivePairs(cameras, None, SETUP.rig, 30.0, 100.0)  # type: ignore[arg-type]
    try:
        assert soon(live.pair).t_left == pytest.approx(1.0)
        failing.things.append(OSError("no device"))
        assert soon(lambda: None if failing.things else True)
    finally:
        live.close()
    assert len(said) == 3
    assert "left camera" in said[0]
    assert "no device" in said[0]
    assert said[1] == "left camera: reads again; reads that failed: 20"
    assert said[2] == said[0]
