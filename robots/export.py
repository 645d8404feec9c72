"""An arm's joints written as a URDF, and a robot file's table as one."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from robots.arm import Arm, DhArm
from robots.errors import RobotError
from robots.transforms import Array

N_DIGITS = 15  # digits: a right angle to rounding
TOL_ZERO = 1e-15  # m and rad: rounding of a sine
TOL_GIMBAL = 1e-12  # cos of the pitch: below, roll and yaw are one angle


@dataclass(frozen=True, eq=False)
class WrittenJoint:
    """A joint as a URDF states it: it turns about ±z of its frame."""

    name: str
    before_T_joint: Array  # (4, 4), m: the joint's frame in that of the link before, at angle 0
    sign: float  # 1 or -1
    lower: float  # rad
    upper: float  # rad
    speed: float = 0.0  # rad/s; 0 where none is stated
    linkage: dict[str, int] = field(default_factory=dict)  # how often it turns with others, by name


def export_urdf(arm: Arm) -> str:
    """Write a robot file's table as a URDF, from base_link (DH frame 0) to tool0 (DH frame 6).

    Raises:
        RobotError: a URDF cannot state the arm, or it is one.
    """
    if not isinstance(arm, DhArm):
        raise RobotError(arm.name, "comes from a URDF", "", "Copy that file: " + arm.source + ".")
    if arm.linkage is not None:
        joint = int(np.argmax((arm.linkage != np.eye(arm.dof)).any(axis=1)))
        raise RobotError(
            f"{arm.name}, joint {joint + 1}",
            f"its axis turns by {arm.axis_formula(joint)}",
            "a joint of a URDF turns by its own angle alone",
            f"Export a copy of the robot file without its linkage, and give programs that read it "
            f"{arm.axis_formula(joint)} as the angle of joint {joint + 1}.",
        )
    joints = []
    before = np.eye(4)
    for j, (a, d, cosine, sine) in enumerate(arm.links):
        c, s = np.cos(arm.offset[j]), np.sin(arm.offset[j])
        zero = np.array([[c, -s, 0, 0], [s, c, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
        speed = 0.0 if arm.speed is None else float(arm.speed[j])
        limits = float(arm.lower[j]), float(arm.upper[j])
        joints.append(
            WrittenJoint(f"joint_{j + 1}", before @ zero, float(arm.sign[j]), *limits, speed)
        )
        before = np.array([[1, 0, 0, a], [0, cosine, -sine, 0], [0, sine, cosine, d], [0, 0, 0, 1]])
    comments = [arm.description, arm.source]
    if arm.acceleration is not None:
        comments.append("A URDF states no accelerations and jerks; the robot file does.")
    return urdf_text(arm.name, joints, before, comments)


def urdf_text(
    name: str, joints: Sequence[WrittenJoint], last_T_flange: Array, comments: Sequence[str]
) -> str:
    """Write a chain from base_link to tool0, one link a joint; `last_T_flange` (4, 4), m."""
    from xml.sax.saxutils import quoteattr  # slow to load, by way of urllib

    links = ["base_link", *(f"link_{j + 1}" for j in range(len(joints))), "tool0"]
    lines = ['<?xml version="1.0" encoding="utf-8"?>']
    lines += [f"<!-- {_comment(sentence)} -->" for sentence in comments]
    lines.append(f"<robot name={quoteattr(name)}>")
    lines += [f'  <link name="{link}"/>' for link in links]
    for j, joint in enumerate(joints):
        span = f'lower="{_number(joint.lower)}" upper="{_number(joint.upper)}"'
        lines += [
            f'  <joint name={quoteattr(joint.name)} type="revolute">',
            f'    <parent link="{links[j]}"/>',
            f'    <child link="{links[j + 1]}"/>',
            f"    {_origin(joint.before_T_joint)}",
            f'    <axis xyz="0 0 {joint.sign:g}"/>',
            f'    <limit {span} effort="0" velocity="{_number(joint.speed)}"/>',
            *(
                f'    <linkage joint={quoteattr(other)} factor="{factor}"/>'
                for other, factor in joint.linkage.items()
            ),
            "  </joint>",
        ]
    lines += [
        '  <joint name="flange" type="fixed">',
        f'    <parent link="{links[-2]}"/>',
        '    <child link="tool0"/>',
        f"    {_origin(last_T_flange)}",
        "  </joint>",
        "</robot>",
    ]
    return "\n".join(lines) + "\n"


def _origin(pose: Array) -> str:
    """URDF's roll, pitch, yaw turn about the fixed x, y, z axes, in this order."""
    r = pose[:3, :3]
    level = np.hypot(r[0, 0], r[1, 0])
    pitch = np.arctan2(-r[2, 0], level)
    if level > TOL_GIMBAL:
        roll, yaw = np.arctan2(r[2, 1], r[2, 2]), np.arctan2(r[1, 0], r[0, 0])
    else:  # any pair with their sum or difference
        roll, yaw = np.arctan2(-r[1, 2], r[1, 1]), 0.0
    place = " ".join(_number(v) for v in pose[:3, 3])
    return f'<origin xyz="{place}" rpy="{" ".join(_number(v) for v in (roll, pitch, yaw))}"/>'


def _number(value: float) -> str:
    return f"{0.0 if abs(value) < TOL_ZERO else float(value):.{N_DIGITS}g}"


def _comment(sentence: str) -> str:
    """One line; XML allows no two hyphens inside a comment, and none at its end."""
    text = "".join(c if c.isprintable() else " " for c in sentence)
    return text.replace("--", "- -").rstrip("-")
