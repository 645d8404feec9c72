"""Open a ROS 1 bag, a ROS 2 bag or an MCAP file, and stream its messages."""

from collections.abc import Callable, Generator, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

from verify.errors import InputError
from verify.io.files import lacks_memory, refused_as_input_error, require_file

FILES = (".bag", ".mcap", ".db3")
METADATA = "metadata.yaml"  # of a ROS 2 bag, which is a folder
SECOND = 1_000_000_000  # ns
IMAGE, COMPRESSED = "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage"
CAMERA_INFO, JOINT_STATE = "sensor_msgs/msg/CameraInfo", "sensor_msgs/msg/JointState"
TRANSFORMS = "tf2_msgs/msg/TFMessage"
MAX_REASON = 200  # characters of what a library says
REPAIRS = {  # programs of others that mend a recording that was cut off
    ".bag": "Repair it by `rosbag reindex`, or record it again.",
    ".mcap": "Repair it by `mcap recover`, or record it again.",
}

Progress = Callable[[int, int], None]


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

    def __init__(self, path: Path, reader: AnyReader) -> None:
        self.path, self._reader = path, reader
        topics = reader.topics
        self.topics = tuple(
            BagTopic(name, info.msgtype or "", info.msgcount) for name, info in topics.items()
        )

    def of_kind(self, *kinds: str) -> tuple[BagTopic, ...]:
        """Topics of these kinds."""
        return tuple(topic for topic in self.topics if topic.kind in kinds)

    def messages(
        self, topics: Iterable[str], progress: Progress = lambda _done, _total: None
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
            found = f"is cut off: {size} of {whole} bytes"
            raise InputError(path, found, "", _repair(path))


def unreadable(path: Path, error: Exception) -> Exception:
    """Word what rosbags cannot read; want of memory and refusals stay what they are."""
    if lacks_memory(error) or isinstance(error, InputError):
        return error
    reason = " ".join(str(error).split())[:MAX_REASON].rstrip(".") or type(error).__name__
    found = f"cannot be read as a bag ({reason})"
    return InputError(
        path, found, "a whole ROS bag or MCAP file of ROS 2 is expected", _repair(path)
    )


def _repair(path: Path) -> str:
    return REPAIRS.get(path.suffix, "Repair it by `ros2 bag reindex`, or record it again.")
