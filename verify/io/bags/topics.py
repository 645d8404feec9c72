"""Choose the topics of a bag: two cameras' pictures, the joint readings, the cameras' models."""

from collections.abc import Sequence
from dataclasses import dataclass

from verify.errors import InputError
from verify.io.bags.bag import CAMERA_INFO, COMPRESSED, IMAGE, JOINT_STATE, Bag, BagTopic
from verify.io.toml import did_you_mean

PICTURES = (IMAGE, COMPRESSED)
MAX_NAMED = 12  # topics in a refusal


@dataclass(frozen=True, slots=True)
class ChosenTopics:
    """Topics that a session is made of."""

    left: BagTopic
    right: BagTopic
    joints: BagTopic

    @property
    def names(self) -> tuple[str, str, str]:
        """Their names: left, right, joints."""
        return self.left.name, self.right.name, self.joints.name


def choose_topics(
    bag: Bag, left: str | None = None, right: str | None = None, joints: str | None = None
) -> ChosenTopics:
    """Take the topics that are named; for the others the one that it can only be.

    Raises:
        InputError: there is none or more than one, it is of another kind, or empty; lists the
            topics and names the option.
    """
    sides = [
        _named(bag, f"--{side}", name, PICTURES) if name else _of_side(bag, side)
        for side, name in (("left", left), ("right", right))
    ]
    if sides[0].name == sides[1].name:
        found = f"{sides[1].name} is the left camera's too"
        raise InputError("--right", found, "each camera has its own pictures")
    if joints:
        readings = _named(bag, "--joints", joints, (JOINT_STATE,))
    else:
        readings = _only(bag, "--joints", bag.of_kind(JOINT_STATE), "sensor_msgs/JointState")
    chosen = ChosenTopics(sides[0], sides[1], readings)
    for topic in (chosen.left, chosen.right, chosen.joints):
        if not topic.count:
            remedy = "Record it again, or name another topic."
            raise InputError(f"{bag.path}, {topic.name}", "has no messages", "", remedy)
    return chosen


def camera_info_topic(bag: Bag, pictures: str) -> str | None:
    """Find the camera model that belongs to a picture topic: camera_info in its namespace."""
    infos = {topic.name for topic in bag.of_kind(CAMERA_INFO) if topic.count}
    parts = pictures.split("/")
    # /left/image_raw and /left/image_raw/compressed both go with /left/camera_info
    for depth in range(len(parts) - 1, 0, -1):
        name = "/".join([*parts[:depth], "camera_info"])
        if name in infos and depth > 1:
            return name
    return None


def _named(bag: Bag, option: str, name: str, kinds: Sequence[str]) -> BagTopic:
    topic = next((t for t in bag.topics if t.name == name), None)
    if topic is None:
        names = tuple(t.name for t in bag.of_kind(*kinds))
        found = f"{bag.path} has no topic {name}"
        raise InputError(
            option, found, f"it has {_listed(names)}", did_you_mean(name, names).strip()
        )
    if topic.kind not in kinds:
        expected = f"{' or '.join(kinds)} is expected"
        raise InputError(option, f"{name} is of the type {topic.kind}", expected)
    return topic


def _of_side(bag: Bag, side: str) -> BagTopic:
    """The picture topic with the side in its name; uncompressed ones come first."""
    found = [t for t in bag.of_kind(*PICTURES) if side in t.name.lower()]
    raw = [t for t in found if t.kind == IMAGE and t.count]
    if len(raw) == 1:
        return raw[0]
    if not found:
        names = [t.name for t in bag.of_kind(*PICTURES)]
        remedy = f"Say which one is the {side} camera's: --{side} TOPIC."
        what = f'has no picture topic with "{side}" in its name'
        raise InputError(bag.path, what, f"it has {_listed(names)}", remedy)
    return _only(bag, f"--{side}", tuple(found), f"pictures of the {side} camera")


def _only(bag: Bag, option: str, found: tuple[BagTopic, ...], what: str) -> BagTopic:
    if len(found) == 1:
        return found[0]
    if not found:
        names = [f"{t.name} ({t.kind})" for t in bag.topics]
        raise InputError(bag.path, f"has no topic of {what}", f"it has {_listed(names)}",
                         "Record that topic too.")  # fmt: skip
    names = [topic.name for topic in found]
    remedy = f"Choose one: {option} TOPIC."
    raise InputError(bag.path, f"has {len(found)} topics of {what}: {_listed(names)}", "", remedy)


def _listed(names: Sequence[str]) -> str:
    more = f" and {len(names) - MAX_NAMED} more" if len(names) > MAX_NAMED else ""
    return (", ".join(names[:MAX_NAMED]) or "none") + more
