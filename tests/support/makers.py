"""Arms as public URDFs state them: the truth that robot files and closed forms are held against.

Numbers alone, each with the file and the commit that it was read from.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

Vector = tuple[float, float, float]


@dataclass(frozen=True)
class PublishedJoint:
    """A joint of the file: its origin in the joint before, its axis, and its limits in rad."""

    xyz: Vector  # m
    axis: Vector
    lower: float
    upper: float
    rpy: Vector = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class PublishedArm:
    """Six joints from base_link to tool0."""

    name: str
    joints: tuple[PublishedJoint, ...]
    tool_rpy: Vector = (0.0, 0.0, 0.0)
    base_height: float = 0.0  # m: where the controller's own base frame is, above base_link

    def write(self, folder: Path) -> Path:
        """Write it as a URDF."""
        links = ["base_link", *(f"link_{i}" for i in range(1, 7)), "tool0"]
        lines = [f'<robot name="{self.name}">', *(f'<link name="{link}"/>' for link in links)]
        for i, joint in enumerate(self.joints, start=1):
            parent = links[i - 1]
            lines.append(
                f'<joint name="joint_{i}" type="revolute"><parent link="{parent}"/>'
                f'<child link="link_{i}"/>{_origin(joint.xyz, joint.rpy)}'
                f'<axis xyz="{_text(joint.axis)}"/><limit lower="{joint.lower!r}" '
                f'upper="{joint.upper!r}" effort="0" velocity="1"/></joint>'
            )
        lines.append(
            '<joint name="flange" type="fixed"><parent link="link_6"/><child link="tool0"/>'
            f"{_origin((0.0, 0.0, 0.0), self.tool_rpy)}</joint>"
        )
        path = folder / f"{self.name}.urdf"
        path.write_text("\n".join([*lines, "</robot>"]), encoding="utf-8")
        return path


def _origin(xyz: Vector, rpy: Vector) -> str:
    return f'<origin xyz="{_text(xyz)}" rpy="{_text(rpy)}"/>'


def _text(numbers: Vector) -> str:
    return " ".join(repr(float(v)) for v in numbers)


def _degrees(xyz: Vector, axis: Vector, lower: float, upper: float) -> PublishedJoint:
    return PublishedJoint(xyz, axis, float(np.radians(lower)), float(np.radians(upper)))


X, Y, Z = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
MINUS_X, MINUS_Y, MINUS_Z = (-1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.0, -1.0)

# ros-industrial/fanuc at 02366c88, fanuc_lrmate200id_support/urdf/lrmate200id_macro.xacro; limits
# by the manual B-83494EN/03, as its package.xml says. There joint_3 is the pendant's J3 + J2.
LR_MATE_200ID = PublishedArm(
    "lr_mate_200id",
    (
        PublishedJoint((0.0, 0.0, 0.330), Z, -2.965, 2.965),
        PublishedJoint((0.050, 0.0, 0.0), Y, -1.745329, 2.530727),
        PublishedJoint((0.0, 0.0, 0.330), MINUS_Y, -2.450966, 4.886922),
        PublishedJoint((0.0, 0.0, 0.035), MINUS_X, -3.315, 3.315),
        PublishedJoint((0.335, 0.0, 0.0), MINUS_Y, -2.18, 2.18),
        PublishedJoint((0.080, 0.0, 0.0), MINUS_X, -6.285, 6.285),
    ),
    tool_rpy=(np.pi, -np.pi / 2, 0.0),
    base_height=0.330,
)

# ros-industrial/kuka_experimental at 2510a098, kuka_kr6_support/urdf/kr6r900sixx_macro.xacro;
# limits by Spez KR AGILUS sixx V12, as its package.xml says
KR6_R900_SIXX = PublishedArm(
    "kr6_r900_sixx",
    (
        _degrees((0.0, 0.0, 0.400), MINUS_Z, -170, 170),
        _degrees((0.025, 0.0, 0.0), Y, -190, 45),
        _degrees((0.455, 0.0, 0.0), Y, -120, 156),
        _degrees((0.0, 0.0, 0.035), MINUS_X, -185, 185),
        _degrees((0.420, 0.0, 0.0), Y, -120, 120),
        _degrees((0.080, 0.0, 0.0), MINUS_X, -350, 350),
    ),
    tool_rpy=(0.0, np.pi / 2, 0.0),
)

# ros-industrial/abb at 59e17fb6, abb_irb120_support/urdf/irb120_3_58_macro.xacro; limits by the
# data sheet ROB0149EN_D, as its package.xml says
IRB_120 = PublishedArm(
    "irb_120",
    (
        PublishedJoint((0.0, 0.0, 0.0), Z, -2.87979, 2.87979),
        PublishedJoint((0.0, 0.0, 0.29), Y, -1.91986, 1.91986),
        PublishedJoint((0.0, 0.0, 0.27), Y, -1.91986, 1.22173),
        PublishedJoint((0.0, 0.0, 0.07), X, -2.79253, 2.79253),
        PublishedJoint((0.302, 0.0, 0.0), Y, -2.094395, 2.094395),
        PublishedJoint((0.072, 0.0, 0.0), X, -6.98132, 6.98132),
    ),
    tool_rpy=(0.0, np.pi / 2, 0.0),
)

# xArm-Developer/xarm_ros at a083c363, xarm_description/config/kinematics/default/
# xarm6_default_kinematics.yaml: right angles rounded as they are there; limits of no consequence
XARM6 = PublishedArm(
    "xarm6",
    (
        _degrees((0.0, 0.0, 0.267), Z, -180, 180),
        PublishedJoint((0.0, 0.0, 0.0), Z, -np.pi, np.pi, rpy=(-1.5708, 0.0, 0.0)),
        _degrees((0.0535, -0.2845, 0.0), Z, -180, 180),
        PublishedJoint((0.0775, 0.3425, 0.0), Z, -np.pi, np.pi, rpy=(-1.5708, 0.0, 0.0)),
        PublishedJoint((0.0, 0.0, 0.0), Z, -np.pi, np.pi, rpy=(1.5708, 0.0, 0.0)),
        PublishedJoint((0.076, 0.097, 0.0), Z, -np.pi, np.pi, rpy=(-1.5708, 0.0, 0.0)),
    ),
)
