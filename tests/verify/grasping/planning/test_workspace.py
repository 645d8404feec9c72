"""Clearances: against pinocchio's frames and sampled bodies, and along ways against brute force."""

import dataclasses
from itertools import pairwise
from pathlib import Path

import msgspec
import numpy as np
import pinocchio
import pytest
from numpy.testing import assert_allclose

import robots
from robots.trajectory import joint_path
from tests.support.grasp.cells import CAMERAS, home, melfa, setup
from verify.core.records import Array
from verify.grasping.planning.workspace import BOX_NAME, RESOLUTION, Workspace


@pytest.fixture
def workspace(tmp_path: Path) -> Workspace:
    return setup(tmp_path)


SAMPLED = 6e-3  # m: random points miss a sphere's lowest by less, 4000 of them a link


def random_postures(count: int, seed: int = 0) -> Array:
    arm = melfa()
    return np.random.default_rng(seed).uniform(arm.lower, arm.upper, (count, 6))


def pinocchio_joints(q: Array) -> list[Array]:
    """Where the shoulder, the elbow's two ends, the wrist and the flange are, by pinocchio."""
    model = robots.pinocchio_model(melfa())
    data = model.createData()
    pinocchio.framesForwardKinematics(model, data, q)
    places = [data.oMi[j].translation.copy() for j in (2, 3, 4, 5)]
    return [*places, data.oMf[model.getFrameId("flange")].translation.copy()]


def body_points(places: list[Array], radius: float, random: np.random.Generator) -> Array:
    """Points on spheres swept along a chain: the surface of capsules, sampled."""
    points = []
    for a, b in pairwise(places):
        share = random.uniform(size=(4000, 1))
        around = random.normal(size=(4000, 3))
        around /= np.linalg.norm(around, axis=1, keepdims=True)
        points.append(a + share * (b - a) + radius * around)
    return np.concatenate(points)


def test_margins_to_table_and_cameras_are_those_of_sampled_bodies(workspace: Workspace) -> None:
    random = np.random.default_rng(1)
    moving, table = workspace.cell.moving, workspace.cell.table
    for q in random_postures(8, seed=2):
        places = pinocchio_joints(q)
        margins = dict(zip(workspace.names, workspace.margins(q[None])[0], strict=True))
        body = body_points(places, moving.link_radius, random)
        links = [f"{part} over the table" for part in ("upper arm", "elbow", "forearm", "wrist")]
        lowest = body[:, 2].min() - table.height - table.clearance
        ours = min(margins[name] for name in links)
        assert ours - 1e-9 <= lowest <= ours + SAMPLED
        nearest = np.linalg.norm(body - CAMERAS[0], axis=1).min() - moving.camera_clearance
        ours = min(v for name, v in margins.items() if "camera 1" in name and "hand" not in name)
        assert ours - 1e-9 <= nearest <= ours + SAMPLED


def test_the_hand_is_a_cylinder_with_flat_ends(workspace: Workspace) -> None:
    random = np.random.default_rng(3)
    hand, table = workspace.cell.gripper, workspace.cell.table
    angle = random.uniform(0, 2 * np.pi, 20000)
    for q in random_postures(8, seed=4):
        grip = workspace.grip(q)
        rim = np.stack([hand.radius * np.cos(angle), hand.radius * np.sin(angle)], axis=1)
        tips = np.column_stack([rim, np.full(len(rim), hand.tips)]) @ grip[:3, :3].T + grip[:3, 3]
        margins = dict(zip(workspace.names, workspace.margins(q[None])[0], strict=True))
        lowest = tips[:, 2].min() - table.height - table.finger_clearance
        assert margins["finger tips over the table"] == pytest.approx(lowest, abs=1e-6)


def test_the_box_holds_the_grip_point(workspace: Workspace, tmp_path: Path) -> None:
    q = home(setup(tmp_path))
    grip = robots.forward(melfa(), q)[:3] @ [0, 0, 0.15, 1.0]
    assert_allclose(workspace.grip(q)[:3, 3], grip)
    inside = min(*(grip - workspace.cell.lower), *(workspace.cell.upper - grip))
    assert workspace.margins(q[None])[0, workspace.names.index(BOX_NAME)] == pytest.approx(inside)
    out = dataclasses.replace(
        workspace, cell=dataclasses.replace(workspace.cell, upper=np.array([0.56, 0.3, 0.4]))
    )
    assert workspace.clear(q[None]) == ""
    assert out.clear(q[None]) == "the grip point would be 95 mm outside the workspace box"


def test_no_point_of_the_arm_moves_farther_than_its_joints_reach(workspace: Workspace) -> None:
    random = np.random.default_rng(5)
    start = random_postures(200, seed=6)
    end = start + random.normal(0, 0.05, start.shape)
    farthest = np.zeros(len(start))
    joints, moved = (
        np.swapaxes(robots.link_frames(workspace.arm, q)[:, 1:, :3, 3], 0, 1) for q in (start, end)
    )
    g0, g1 = workspace.grip(start), workspace.grip(end)
    hand = workspace.cell.gripper
    rim = np.array([[hand.radius, 0, hand.tips, 1], [0, -hand.radius, hand.tips, 1.0]])
    pairs = [*zip(joints, moved, strict=True)]
    pairs += [((g0 @ point)[:, :3], (g1 @ point)[:, :3]) for point in rim]
    for a, b in pairs:
        farthest = np.maximum(farthest, np.linalg.norm(a - b, axis=1))
    assert np.all(farthest <= np.abs(end - start) @ workspace.reach)


def test_a_way_is_judged_as_brute_force_judges_it(workspace: Workspace) -> None:
    random = np.random.default_rng(7)
    found = {True: 0, False: 0}
    postures = random_postures(20000, seed=8)
    clear = postures[workspace.margins(postures).min(axis=1) > 0]
    for _ in range(30):
        start, end = clear[random.integers(0, len(clear), 2)]
        path = joint_path(start, end)
        worst = workspace.margins(path.q(np.linspace(0, 1, 2001))).min()
        message = workspace.along(path)
        if message:  # refused: brute force sees it too, but for what it slips past
            assert worst < -RESOLUTION + 1e-3
            assert "of the way" in message
        else:
            assert worst >= -RESOLUTION
        found[bool(message)] += 1
    assert min(found.values()) >= 5


def test_a_thin_obstacle_does_not_slip_between_samples(workspace: Workspace) -> None:
    """A camera beside the way of the finger tips, seen by 1 % of it, between the first samples."""
    start, end = np.radians([[-25, 20, 95, 0, 65, 0], [25, 20, 95, 0, 65, 0]])
    way = joint_path(start, end)
    assert workspace.along(way) == ""
    share = 0.5 + 1 / 32  # between two of the nine postures that are looked at first
    tips = workspace.grip(way.q(share))
    moving = msgspec.structs.replace(workspace.cell.moving, camera_clearance=0.0, link_radius=0.01)
    outward = tips[:2, 3] / np.linalg.norm(tips[:2, 3])
    far = workspace.cell.gripper.radius - 0.001
    camera = tips[:3, 3] + far * np.array([*outward, 0.0])
    near = dataclasses.replace(
        workspace, cameras=camera[None], cell=dataclasses.replace(workspace.cell, moving=moving)
    )
    assert near.margins(way.q(np.linspace(0, 1, 9))).min() > 0
    assert "camera 1" in near.along(way)


def test_a_stream_of_postures_is_checked_in_between(workspace: Workspace) -> None:
    low = np.radians([[0, 70, 100, 0, 10, 0]])
    assert "table" in workspace.clear(low)
    up = np.radians([[0, 0, 90, 0, 90, 0]])
    over = np.radians([[0.5, 0, 90, 0, 90, 0]])
    assert workspace.clear(np.concatenate([up, over])) == ""
    assert workspace.clear(np.concatenate([up, low])) != ""
