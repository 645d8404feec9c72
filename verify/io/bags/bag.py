"""Open a ROS 1 bag, a ROS 2 bag or an MCAP file, choose its topics, and stream its messages."""

from collections.abc import Generator, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

from verify.core.records import Progress, no_progress
from verify.errors import InputError
from verify.io.bags.mcap import McapReader, has_own_encoding
from verify.io.files import lacks_memory, refused_as_input_error, require_file
from verify.io.toml import did_you_mean, listed

FILES = (".bag", ".mcap", ".db3")
METADATA = "metadata.yaml"  # of a ROS 2 bag, which is a folder
SECOND = 1_000_000_000  # ns
IMAGE, COMPRESSED = "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage"
CAMERA_INFO, JOINT_STATE = "sensor_msgs/msg/CameraInfo", "sensor_msgs/msg/JointState"
TRANSFORMS = "tf2_msgs/msg/TFMessage"
PICTURES = (IMAGE, COMPRESSED)
MODEL_NAMES = ("camera_info", "calibration")  # of ROS; of Foxglove's examples
MAX_REASON = 200  # characters of what a library says
REPAIRS = {  # programs of others that mend a recording that was cut off
    ".bag": "Repair it by `rosbag reindex`, or record it again.",
    ".mcap": "Repair it by `mcap recover`, or record it again.",
}


@dataclass(frozen=True, slots=True)
class BagTopic:
    """A topic of a bag."""

    name: str
    kind: str  # like sensor_msgs/msg/Image, of ROS 1 too
    count: int  # messages


@dataclass(frozen=True, slots=True)
class BagMessage:
    """A message, and where it stands."""

    topic: str
    number: int  # within its topic, from 0
    received: int  # ns since 1970: when it was recorded
    content: Any  # with the fields that its definition names

    @property
    def stamp(self) -> int:
        """Time of its header, ns since 1970; 0: it has none."""
        stamp = self.content.header.stamp
        return int(stamp.sec) * SECOND + int(stamp.nanosec)


def is_bag(path: Path) -> bool:
    """Whether a path looks like a bag or an MCAP file."""
    return path.suffix in FILES or (path / METADATA).is_file()


class Bag:
    """A bag that is open."""

    def __init__(self, path: Path, reader: AnyReader | McapReader) -> None:
        self.path = path
        self._reader: Any = reader
        topics = reader.topics
        self.topics = tuple(
            BagTopic(name, info.msgtype or "", info.msgcount) for name, info in topics.items()
        )

    def of_kind(self, *kinds: str) -> tuple[BagTopic, ...]:
        """Topics of these kinds."""
        return tuple(topic for topic in self.topics if topic.kind in kinds)

    def messages(
        self, topics: Iterable[str], progress: Progress = no_progress
    ) -> Generator[BagMessage]:
        """Stream the messages of some topics, one in memory, in the order of their arrival.

        Raises:
            InputError: the file is damaged, or ends before the last message that it announces.
        """
        wanted = set(topics)
        connections = [c for c in self._reader.connections if c.topic in wanted]
        total = sum(c.msgcount for c in connections)
        if not connections or not total:
            return
        stream = self._reader.messages(connections)
        counts = dict.fromkeys(wanted, 0)
        for done in range(total + 1):
            try:
                taken = next(stream, None)
                if taken is None:
                    break
                connection, received, raw = taken
                content = self._reader.deserialize(raw, connection.msgtype)
            except Exception as error:  # damaged bytes raise whatever the parsers run into
                raise unreadable(self.path, error) from error
            number = counts[connection.topic]
            counts[connection.topic] = number + 1
            yield BagMessage(connection.topic, number, received, content)
            progress(done + 1, total)
        if done < total:
            found = f"ends after {done} of {total} messages"
            raise InputError(self.path, found, "", _repair(self.path))


@contextmanager
def open_bag(path: Path) -> Iterator[Bag]:
    """Open a bag: a .bag, .mcap or .db3 file, or the folder of a ROS 2 bag.

    An MCAP file may hold Foxglove's schemas or ROS 1 instead.

    Raises:
        InputError: there is none, or it is damaged, cut off or of a kind that is not known.
    """
    with refused_as_input_error(path):
        folder = path.is_dir()
    if not folder:
        require_file(path)
    for database in path.glob("*.db3") if folder else (path,):
        _require_whole_database(database)
    # older ROS 2 bags do not hold the definitions of their messages
    store = get_typestore(Stores.ROS2_HUMBLE)
    try:
        reader: AnyReader | McapReader
        if path.suffix == ".mcap" and not folder and has_own_encoding(path):
            reader = McapReader(path)
        else:
            reader = AnyReader([path], default_typestore=store)
            reader.open()
    except Exception as error:  # damaged bytes raise whatever the parsers run into
        raise unreadable(path, error) from error
    try:
        yield Bag(path, reader)
    finally:
        reader.close()


def _require_whole_database(path: Path) -> None:
    """Refuse, by an InputError, an SQLite file shorter than its head says: it is read regardless.

    Source: SQLite, Database File Format, section 1.3: page size and number of pages.
    """
    with refused_as_input_error(path), path.open("rb") as file:
        head, size = file.read(32), path.stat().st_size
    if head.startswith(b"SQLite format 3\0") and len(head) == 32:
        page = int.from_bytes(head[16:18], "big")
        whole = (65536 if page == 1 else page) * int.from_bytes(head[28:32], "big")
        if size < whole:
            raise InputError(path, f"is cut off: {size} of {whole} bytes", "", _repair(path))


def unreadable(path: Path, error: Exception) -> Exception:
    """Word what rosbags cannot read; want of memory and refusals stay what they are."""
    if lacks_memory(error) or isinstance(error, InputError):
        return error
    reason = " ".join(str(error).split())[:MAX_REASON].rstrip(".") or type(error).__name__
    if reason == "Profile is not ros2":  # of a file without the summary that tells what it holds
        reason = "cut off, or neither ROS nor JSON or protobuf"
    found = f"cannot be read as a bag ({reason})"
    return InputError(path, found, "a whole ROS bag or MCAP file is expected", _repair(path))


def _repair(path: Path) -> str:
    return REPAIRS.get(path.suffix, "Repair it by `ros2 bag reindex`, or record it again.")


class ChosenTopics(NamedTuple):
    """Topics that a session is made of."""

    left: BagTopic
    right: BagTopic
    joints: BagTopic


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
    for topic in chosen:
        if not topic.count:
            remedy = "Record it again, or name another topic."
            raise InputError(f"{bag.path}, {topic.name}", "has no messages", "", remedy)
    return chosen


def camera_info_topic(bag: Bag, pictures: str) -> str | None:
    """Find the camera model that belongs to a picture topic: camera_info in its namespace."""
    infos = {topic.name for topic in bag.of_kind(CAMERA_INFO) if topic.count}
    parts = pictures.split("/")
    # /left/image_raw and /left/image_raw/compressed both go with /left/camera_info
    for depth in range(len(parts) - 1, 1, -1):
        for name in ("/".join([*parts[:depth], last]) for last in MODEL_NAMES):
            if name in infos:
                return name
    return None


def _named(bag: Bag, option: str, name: str, kinds: Sequence[str]) -> BagTopic:
    topic = next((t for t in bag.topics if t.name == name), None)
    if topic is None:
        names = tuple(t.name for t in bag.of_kind(*kinds))
        found, hint = f"{bag.path} has no topic {name}", did_you_mean(name, names).strip()
        raise InputError(option, found, f"it has {listed(names) or 'none'}", hint)
    if topic.kind not in kinds:
        expected = f"{' or '.join(kinds)} is expected"
        raise InputError(option, f"{name} is of the type {topic.kind}", expected)
    return topic


def _of_side(bag: Bag, side: str) -> BagTopic:
    """The picture topic with the side in its name; uncompressed ones come first."""
    pictures = bag.of_kind(*PICTURES)
    found = [t for t in pictures if side in t.name.lower()]
    raw = [t for t in found if t.kind == IMAGE and t.count]
    if len(raw) == 1:
        return raw[0]
    if not found:
        names = [t.name for t in pictures]
        remedy = f"Say which one is the {side} camera's: --{side} TOPIC."
        what = f'has no picture topic with "{side}" in its name'
        raise InputError(bag.path, what, f"it has {listed(names) or 'none'}", remedy)
    return _only(bag, f"--{side}", tuple(found), f"pictures of the {side} camera")


def _only(bag: Bag, option: str, found: tuple[BagTopic, ...], what: str) -> BagTopic:
    if len(found) == 1:
        return found[0]
    if not found:
        names = [f"{t.name} ({t.kind})" for t in bag.topics]
        expected = f"it has {listed(names) or 'none'}"
        raise InputError(bag.path, f"has no topic of {what}", expected, "Record that topic too.")
    names = [topic.name for topic in found]
    remedy = f"Choose one: {option} TOPIC."
    raise InputError(bag.path, f"has {len(found)} topics of {what}: {listed(names)}", "", remedy)
