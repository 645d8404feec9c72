"""A URDF's chain of revolute joints as an arm."""

import hashlib
import re
import xml.etree.ElementTree as ElementTree
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from robots.arm import UrdfArm
from robots.definition import linkage_matrix
from robots.errors import RobotError
from robots.recognition import recognise

if TYPE_CHECKING:
    import pinocchio

TURNING_TYPES = {"revolute", "continuous"}
# not a joint of the arm
GRIPPER_NAMES = re.compile(r"grip|finger|jaw|knuckle|thumb", re.IGNORECASE)
# rad: a joint without limits gets two turns, so that ranges are finite
MAX_CONTINUOUS_ANGLE = 2 * np.pi


MAX_LIMIT = 1000.0  # rad; more is no angle
MAX_LENGTH = 1000.0  # m, from a link to the next; more is another unit
MAX_JOINTS = 16  # of an arm
MAX_PARTS = 1000  # joints in a file: a humanoid with its hands has a tenth


@dataclass(frozen=True)
class Joint:
    """A joint in the file; pinocchio's model does not hold mimicry."""

    name: str
    kind: str
    parent: str
    child: str
    mimics: bool
    linkage: dict[str, str]  # how often it turns with an earlier joint


def read(path: Path, base: str | None, tip: str | None, name: str, source: str) -> UrdfArm:
    """Load the chain from `base` to `tip`; every other joint of the file is locked at 0.

    By default the base is the first link (the one without a parent), and the tip the last link of
    the chain that starts there. The chain ends before a prismatic joint, a joint that mimics
    another, anything named as a gripper's, or a split into several; among the links fixed at its
    end the last is tool0, or else the one behind the most fixed joints.

    Raises:
        RobotError: the file cannot be read, a link is unknown, the chain is not single, or it holds
            a joint that is not an angle of its own.
    """
    import pinocchio

    content, joints, links = _parse(path)
    base = base or _first_link(path, joints, links)
    for link in (base, tip or base):
        if link not in links:
            expected = f"its links are {', '.join(sorted(links))}"
            raise RobotError(path, f'no link "{link}"', expected, "Name one of them.")
    tip = tip or _last_link(joints, base)
    chain = _chain(path, joints, base, tip)
    if len(chain) > MAX_JOINTS:
        found = f"{len(chain)} turning joints from {base} to {tip}"
        raise RobotError(
            path, found, f"an arm has at most {MAX_JOINTS}", "Name base and tip of the arm."
        )
    model = _lock_other_joints(path, chain)
    limits = np.array([_limits(path, model, joint) for joint in chain])
    names = [joint.name for joint in chain]
    arm = UrdfArm(
        name=name,
        description=f"{len(chain)} revolute joints, {base} to {tip}",
        source=source,
        fingerprint=hashlib.sha256(content).hexdigest(),
        lower=limits[:, 0],
        upper=limits[:, 1],
        linkage=linkage_matrix(path, names, [joint.linkage for joint in chain]),
        model=model,
        base=base,
        tip=tip,
        base_frame=model.getFrameId(base, pinocchio.FrameType.BODY),
        tip_frame=model.getFrameId(tip, pinocchio.FrameType.BODY),
        joint_names=tuple(names),
    )
    return replace(arm, closed_form=recognise(arm))


def _limits(path: Path, model: "pinocchio.Model", joint: Joint) -> tuple[float, float]:
    turning = model.joints[model.getJointId(joint.name)]
    if not np.any(turning.createData().S):
        place = f'{path}, joint "{joint.name}", axis'
        raise RobotError(place, "has no length", "a joint turns about a direction")
    if joint.kind == "continuous":
        return -MAX_CONTINUOUS_ANGLE, MAX_CONTINUOUS_ANGLE
    at = turning.idx_q
    lower, upper = (float(q[at]) for q in (model.lowerPositionLimit, model.upperPositionLimit))
    if not -MAX_LIMIT <= lower < upper <= MAX_LIMIT:
        found = f"lower {lower:g}, upper {upper:g}"
        expected = f"radians within ±{MAX_LIMIT:g}, the lower one less"
        raise RobotError(f'{path}, joint "{joint.name}", limit', found, expected)
    return lower, upper


def _parse(path: Path) -> tuple[bytes, list[Joint], set[str]]:
    try:
        content = path.read_bytes()
        root = ElementTree.fromstring(content)
    except OSError as error:
        raise RobotError(path, error.strerror or "cannot be read", "", "Check the path.") from error
    except (ElementTree.ParseError, LookupError, ValueError) as error:  # encodings not known
        remedy = "Expand a xacro file first." if path.suffix == ".xacro" else "Correct that line."
        if not isinstance(error, ElementTree.ParseError):
            remedy = "Save it as UTF-8."
        raise RobotError(path, f"not valid XML: {error}", "", remedy) from error
    if root.tag != "robot":
        remedy = "Give the robot's own file."
        raise RobotError(path, f"<{root.tag}>", "a URDF holds <robot>", remedy)
    joints = []
    for node in root.findall("joint"):
        found = (node.find("parent"), node.find("child"))
        ends = [end.get("link", "") for end in found if end is not None]
        if len(ends) != 2:
            place = f'{path}, joint "{node.get("name")}"'
            raise RobotError(place, "parent or child missing", "a joint has both", "Add it.")
        mimics = node.find("mimic") is not None
        linkage = {o.get("joint", ""): o.get("factor", "1") for o in node.findall("linkage")}
        name, kind = node.get("name", ""), node.get("type", "")
        joints.append(Joint(name, kind, ends[0], ends[1], mimics, linkage))
    if len(joints) > MAX_PARTS:
        expected = f"a robot has at most {MAX_PARTS}"
        raise RobotError(path, f"{len(joints)} joints", expected, "Give the arm's own file.")
    return content, joints, {link.get("name", "") for link in root.findall("link")}


def _first_link(path: Path, joints: list[Joint], links: set[str]) -> str:
    roots = sorted(links - {joint.child for joint in joints})
    if len(roots) != 1:
        found = f"{len(roots)} links without a parent: {', '.join(roots)}"
        raise RobotError(path, found, "one is needed", "Name base and tip.")
    return roots[0]


def _last_link(joints: list[Joint], base: str) -> str:
    """Follow the only turning joint from link to link, and end at the last fixed link after it."""
    link = base
    while True:
        rigid = _rigid_links(joints, link)
        moving = [joint for joint in joints if joint.parent in rigid and joint.kind != "fixed"]
        if len(moving) == 1 and _is_arm_joint(moving[0]):
            link = moving[0].child
            continue
        if "tool0" in rigid:  # the flange, by ROS-Industrial's convention
            return "tool0"
        arm = [name for name in rigid if name == link or not GRIPPER_NAMES.search(name)]
        return max(arm, key=lambda name: rigid[name])


def _is_arm_joint(joint: Joint) -> bool:
    return joint.kind in TURNING_TYPES and not joint.mimics and not GRIPPER_NAMES.search(joint.name)


def _rigid_links(joints: list[Joint], link: str) -> dict[str, int]:
    """Links fixed to a link, itself included, with the number of fixed joints between."""
    found = {link: 0}
    grown = True
    while grown:
        fixed = [j for j in joints if j.kind == "fixed" and j.parent in found]
        new = {j.child: found[j.parent] + 1 for j in fixed if j.child not in found}
        found.update(new)
        grown = bool(new)
    return found


def _chain(path: Path, joints: list[Joint], base: str, tip: str) -> list[Joint]:
    above = {joint.child: joint for joint in joints}
    chain: list[Joint] = []
    link = tip
    while link != base:
        if link not in above:
            remedy = "Name base and tip so that the tip hangs on the base."
            raise RobotError(path, f'no chain from "{base}" to "{tip}"', "", remedy)
        joint = above.pop(link)  # a second visit would go round for ever
        link = joint.parent
        if joint.kind == "fixed":
            continue
        place = f'{path}, joint "{joint.name}"'
        if joint.kind not in TURNING_TYPES:
            remedy = "Name base and tip so that the chain leaves it out."
            raise RobotError(place, f"a {joint.kind} joint", "every joint must be an angle", remedy)
        if joint.mimics:
            remedy = "Name a tip before it."
            raise RobotError(place, "mimics another joint", "every joint must be its own", remedy)
        chain.insert(0, joint)
    if not chain:
        leaves = sorted({j.child for j in joints} - {j.parent for j in joints})
        found = f'no single chain of revolute joints from "{base}"'
        expected = f"its last links are {', '.join(leaves)}"
        raise RobotError(path, found, expected, "Name base and tip.")
    return chain


def _lock_other_joints(path: Path, chain: list[Joint]) -> "pinocchio.Model":
    """Load the file, and lock all but the chain's joints at 0; RobotError: it is no robot."""
    import pinocchio

    try:
        model = pinocchio.buildModelFromUrdf(str(path))
        kept = {joint.name for joint in chain}
        locked = [i for i in range(1, model.njoints) if model.names[i] not in kept]
        reduced = pinocchio.buildReducedModel(model, locked, pinocchio.neutral(model))
    except (ValueError, RuntimeError) as error:
        raise RobotError(path, f"pinocchio refuses it: {error}", "", "Correct the URDF.") from error
    placements = [*reduced.jointPlacements, *(frame.placement for frame in reduced.frames)]
    longest = max(np.abs(placement.translation).max() for placement in placements)
    if not longest <= MAX_LENGTH:
        expected = f"at most {MAX_LENGTH:g} m is plausible"
        raise RobotError(path, f"an origin is {longest:g} m away", expected, "Write metres.")
    return reduced
