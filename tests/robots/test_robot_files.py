"""Robot files against the public URDFs that they cite; a robot file as a URDF of its own."""

from pathlib import Path

import numpy as np
import pinocchio
import pytest
from numpy.testing import assert_allclose

import robots
from robots.transforms import Array
from tests.support import makers

ARMS = {
    "fanuc_lr_mate_200id": makers.LR_MATE_200ID,
    "kuka_kr6_r900_sixx": makers.KR6_R900_SIXX,
    "abb_irb_120": makers.IRB_120,
}
UNLINKED = [name for name in robots.names() if robots.load(name).linkage is None]


def flange_by_pinocchio(path: Path, base: str, q: Array) -> Array:
    """base_T_tool0 (m, 4, 4), m, of a URDF's own angles (m, 6), rad: pinocchio's parser alone."""
    model = pinocchio.buildModelFromUrdf(str(path))
    data = model.createData()
    frames = [model.getFrameId(name) for name in (base, "tool0")]
    poses = []
    for angles in q:
        pinocchio.framesForwardKinematics(model, data, angles)
        start, end = (data.oMf[frame] for frame in frames)
        poses.append(start.actInv(end).homogeneous)
    return np.array(poses)


@pytest.mark.parametrize("name", ARMS)
def test_a_robot_file_places_the_flange_as_the_urdf_that_it_cites(
    name: str, tmp_path: Path
) -> None:
    arm, cited = robots.load(name), ARMS[name]
    q = np.random.default_rng(1).uniform(arm.lower, arm.upper, (200, 6))
    axes = q.copy()
    if name.startswith("fanuc"):
        axes[:, 2] += q[:, 1]  # the URDF's joint_3 is J3 + J2
    theirs = flange_by_pinocchio(cited.write(tmp_path), "base_link", axes)
    theirs[:, 2, 3] -= cited.base_height
    assert_allclose(robots.forward(arm, q), theirs, atol=1e-9)
    limits = np.degrees([(joint.lower, joint.upper) for joint in cited.joints])
    assert_allclose(np.degrees([arm.lower, arm.upper]).T, limits, atol=0.01)


def test_a_pendants_j3_and_j2_turn_the_forearm_as_on_record() -> None:
    # ros-industrial/fanuc_experimental issue 17: pendant J3, joint_2 and joint_3 of one moment
    arm = robots.load("fanuc_lr_mate_200id")
    q = np.array(
        [0.2743533, 0.5467115640640259, np.radians(-33.342), 1.2852825, -1.764967, -0.5436539]
    )
    assert_allclose(arm.axis_angles(q)[2], -0.035214900970458984, atol=np.radians(0.001))


@pytest.mark.parametrize("name", UNLINKED)
def test_an_exported_urdf_is_the_arm(name: str, tmp_path: Path) -> None:
    arm = robots.load(name)
    path = tmp_path / "exported.urdf"
    path.write_text(robots.export_urdf(arm), encoding="utf-8")
    q = np.random.default_rng(2).uniform(arm.lower, arm.upper, (200, 6))
    pose = robots.forward(arm, q)
    assert_allclose(flange_by_pinocchio(path, "base_link", q), pose, atol=1e-9)
    again = robots.load(str(path))
    assert (again.base, again.tip) == ("base_link", "tool0")
    assert_allclose([again.lower, again.upper], [arm.lower, arm.upper], atol=1e-12)
    model = pinocchio.buildModelFromUrdf(str(path))
    assert_allclose(model.velocityLimit, 0.0 if arm.speed is None else arm.speed, atol=1e-12)
    assert isinstance(again, robots.UrdfArm)
    assert again.closed_form is not None
    assert again.closed_form.table.family == arm.family


def test_what_a_urdf_cannot_state_is_refused() -> None:
    with pytest.raises(
        robots.RobotError, match=r"joint 3: its axis turns by q3 \+ q2; .*own angle"
    ):
        robots.export_urdf(robots.load("fanuc_lr_mate_200id"))
    with pytest.raises(robots.RobotError, match=r"ur5: comes from a URDF. Copy that file"):
        robots.export_urdf(robots.load("ur5"))
