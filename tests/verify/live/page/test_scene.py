"""Cameras in the page's view: where their bases stood for the pair that is shown."""

from dataclasses import replace
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

import robots
from tests.support.grasp.cells import quick_cell
from tests.support.scene import off_axis
from tests.support.spot_level import HOME, facing_rig
from verify.core.records import Array, Measurement, StereoPair
from verify.core.rig import Rig
from verify.grasping.control.run import StopConditions, run
from verify.grasping.page import GraspFacts, GraspPageSource
from verify.live.alarms.joints import AlarmLimits
from verify.live.buffers import PanBuffer
from verify.live.joint_row import JointRow
from verify.live.page.run import RunFacts, RunPageSource
from verify.live.protocols import MonitoredRobot
from verify.live.state import LiveState
from verify.simulation.cell.grab import cell_grab
from verify.simulation.cell.scene import Cap, CellScene, PanTurn
from verify.simulation.cell.setup import ROBOT

TURN = np.deg2rad(7.0)


def turned(rig: Rig, angles: tuple[float, float]) -> list[Array]:
    """Poses in the base after each camera went round its base's axis from where the file has it."""
    poses = []
    for camera, angle in zip((rig.left, rig.right), angles, strict=True):
        spin = Rotation.from_rotvec(angle * camera.pan_axis).as_matrix()
        pose = camera.rig_T_camera(camera.pan).copy()
        pose[:3, :3] = spin @ pose[:3, :3]
        pose[:3, 3] = spin @ (pose[:3, 3] - camera.pan_center) + camera.pan_center
        poses.append(np.linalg.inv(rig.rig_T_base) @ pose)
    return poses


def assert_drawn(
    cameras: list[dict[str, Any]], expected: list[Array], turn: float = 1e-6, mm: float = 0.01
) -> None:
    for drawn, pose in zip(cameras, expected, strict=True):
        np.testing.assert_allclose(drawn["rotation"], pose[:3, :3], atol=turn)
        np.testing.assert_allclose(drawn["at_mm"], 1e3 * pose[:3, 3], atol=mm)


def test_a_run_draws_them_as_they_stood_for_the_pair_on_the_page() -> None:
    rig, marker = facing_rig()
    rig = replace(rig, left=off_axis(rig.left), right=off_axis(rig.right))
    arm, state = robots.load("iust_6r"), LiveState()
    source = RunPageSource(
        state,
        MonitoredRobot(arm, rig, marker, None),
        RunFacts("iust_6r", "", AlarmLimits(0.1, 30.0, None)),
    )
    still = turned(rig, (0.0, 0.0))
    assert_drawn(source.hello()["cameras"], still)
    row = JointRow(
        0, 0.0, "measured", 4, HOME, HOME, np.zeros(6), np.full(6, 5e-4), np.zeros(6), None,
        np.eye(4), np.eye(4),
    )  # fmt: skip
    state.row(row, np.zeros(6))
    assert_drawn(source.rows()[-1]["scene"]["cameras"], still)  # no pair was seen yet
    black = np.zeros((8, 8), np.uint8)
    pair = StereoPair(1, 0.0, 0.0, rig.left.pan + TURN, rig.right.pan - 2 * TURN, black, black)
    state.pictures = (pair, Measurement(1, 0.0, "too_few_leds", 0))
    state.row(replace(row, frame=1), np.zeros(6))
    assert_drawn(source.rows()[-1]["scene"]["cameras"], turned(rig, (TURN, -2 * TURN)))


def test_a_grab_draws_them_as_they_stand_after_a_turn() -> None:
    setup = quick_cell(turning=True)
    scene = CellScene((Cap("blue", (0.47, 0.03)),), turns=(PanTurn(0.6, TURN, 0.2),), seed=1)
    made = cell_grab(setup, scene, bases=PanBuffer())
    source = GraspPageSource(GraspFacts(ROBOT, "", setup.workspace, setup.rig, False, 2.0))
    drawn: list[list[dict[str, Any]]] = []

    def see(cycle: Any) -> None:
        source.show(cycle, made.loop, 0)
        drawn.extend(row["scene"]["cameras"] for row in source.rows())

    run(made.loop, made.source, StopConditions(duration=1.3, patience=1.3, planned=False), see)
    before, after = turned(setup.rig, (0.0, 0.0)), turned(setup.rig, (TURN, TURN))
    assert_drawn(source.hello()["cameras"], before)
    for cameras, expected in ((drawn[5], before), (drawn[-1], after)):
        assert_drawn(cameras, expected, turn=1e-3, mm=1.0)  # as their sensors read
