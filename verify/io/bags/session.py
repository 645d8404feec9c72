"""Turn a bag into a session, in two passes: its stamps, then its pictures and readings.

Two pictures make a pair where each is the other's nearest in time, and no more than half a period
apart; both keep their own stamps. Nothing but the stamps is held in memory.
"""

from collections.abc import Callable, Iterable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import TextIO

import numpy as np
from numpy.typing import NDArray

import robots
from verify.core.records import SIDES, Array, Index
from verify.errors import InputError
from verify.io.bags import pictures
from verify.io.bags.bag import SECOND, Bag, BagMessage, ChosenTopics
from verify.io.encoding import VideoWriter
from verify.io.joints import ANGLE_UNITS, RADIANS, JointRange, match_joint_names
from verify.io.left_out import MAX_SPEED, MIN_SPIKE

HEADER, RECEIVED = "header", "received"  # which time of a message counts
EPOCH = 946_684_800 * SECOND  # 2000-01-01: a stamp before is no date, but a time since start-up
MAX_LATE = 0.01  # share of readings that are not later than the one before, or leap from it
MIN_PAIRS = 2

Stamps = NDArray[np.int64]  # ns
Progress = Callable[[int, int, str], None]


@dataclass(frozen=True, slots=True)
class BagRequest:
    """What a session is to be made of."""

    topics: ChosenTopics
    arm: robots.Arm
    joint_names: tuple[str, ...] = ()  # in the arm's order; () to match those of the bag
    unit: str = RADIANS  # of the joint readings; ROS says radians
    stamps: str = HEADER
    image_size: tuple[int, int] | None = None  # px, of the rig


@dataclass(frozen=True, slots=True)
class BagOutline:
    """What the first pass finds."""

    picture_times: tuple[Stamps, Stamps]  # (n,), of all pictures, left and right
    pairs: Index  # (k, 2), numbers of the pictures that make the pairs
    names: tuple[str, ...]  # of the joints, in the arm's order
    depth: int  # bits a sample of pictures deeper than 8 bits; 8: none is
    start: int  # ns, the session's t = 0
    readings: int  # joint messages with every joint


@dataclass(frozen=True, slots=True)
class BagSession:
    """What was written, and what a user has to know of it."""

    pairs: int
    readings: int
    started: datetime | None
    notes: tuple[str, ...]


def write_bag_session(
    bag: Bag, request: BagRequest, folder: Path, progress: Progress
) -> BagSession:
    """Write left.mkv, right.mkv, frames.csv and encoders.csv into a folder.

    Raises:
        InputError: no stamps, no pairs, joints that cannot be matched or that lie beyond the arm's
            limits, pictures that cannot be decoded, a damaged file.
    """
    outline = _read_outline(bag, request, progress)
    _write_frames(outline, folder / "frames.csv")
    readings = _write_streams(bag, request, outline, folder, progress)
    lost = [len(t) - len(outline.pairs) for t in outline.picture_times]
    notes = [
        "joints: " + ", ".join(f"{name} → q{j}" for j, name in enumerate(outline.names, start=1)),
        _describe_skew(outline),
    ]
    if any(lost):
        notes.append(f"{lost[0]} left and {lost[1]} right pictures have no partner: left out")
    if outline.depth > 8:
        notes.append(f"pictures of {outline.depth} bits: the highest 8 are kept")
    if (late := outline.readings - readings) > 0:
        notes.append(f"{late} joint readings not later than the one before: left out")
    started = None
    if outline.start >= EPOCH:
        started = datetime.fromtimestamp(outline.start // SECOND, UTC)
    return BagSession(len(outline.pairs), readings, started, tuple(notes))


def _read_outline(bag: Bag, request: BagRequest, progress: Progress) -> BagOutline:
    """First pass: all stamps, the depth of the pictures, the joints' names and range."""
    left, right, joints = (topic.name for topic in request.topics)
    times: dict[str, list[int]] = {left: [], right: [], joints: []}
    greatest, joint_names = 0, JointNames(f"{bag.path}, {joints}", request)
    spread = JointRange(request.arm.dof)
    for message in bag.messages(times, lambda d, n: progress(d, 2 * n, "stamps")):
        time = message.stamp if request.stamps == HEADER else message.received
        if message.topic != joints:
            greatest = max(greatest, pictures.greatest_sample(message, _place(bag, message)))
            times[message.topic].append(time)
            continue
        names = joint_names.find(message)
        values = None if names is None else joint_values(message, names)
        if values is not None:
            if not np.isfinite(values).all():
                found = "has a position that is no number"
                raise InputError(_place(bag, message), found, "", "Record it again.")
            spread.add(values)
            times[joints].append(time)
    names = joint_names.require(found=bool(times[joints]))
    spread.require_within(f"{bag.path}, {joints}", request.arm, names, request.unit)
    for topic, stamps in times.items():
        _require_stamps(f"{bag.path}, {topic}", stamps, request.stamps)
    sides = np.array(times[left], np.int64), np.array(times[right], np.int64)
    pairs = pair_stamps(*sides)
    if len(pairs) < MIN_PAIRS:
        found = f"{left} and {right} have {len(pairs)} pictures of one moment"
        expected = "pairs no more than half a period apart are expected"
        raise InputError(bag.path, found, expected, "Are both cameras' clocks one?")
    first = min(int(sides[0][0]), int(sides[1][0]), min(times[joints]))
    depth = next(bits for bits in pictures.DEPTHS if greatest < 2**bits)
    return BagOutline(sides, pairs, names, depth, first // SECOND * SECOND, len(times[joints]))


class JointNames:
    """The names of the arm's joints in messages of one topic, which several devices may share."""

    def __init__(self, place: str, request: BagRequest) -> None:
        self._place, self._request = place, request
        self._names: tuple[str, ...] | None = None
        self._tried: set[frozenset[str]] = set()

    def find(self, message: BagMessage) -> tuple[str, ...] | None:
        """Match a message's names; None: neither it nor one before it names the whole arm.

        Raises:
            InputError: it names another arm than one before it.
        """
        listed = frozenset(map(str, message.content.name))
        if listed in self._tried:
            return self._names
        self._tried.add(listed)
        try:
            found = self._match(listed)
        except InputError:  # another device's, of a gripper perhaps
            return self._names
        if self._names is not None and found != self._names:
            both = f"{', '.join(self._names)} and of {', '.join(found)}"
            remedy = "Name those of the robot in its order: --joint-names NAME1,NAME2,…"
            raise InputError(self._place, f"has the joints of {both}", "one arm", remedy)
        self._names = found
        return found

    def require(self, *, found: bool) -> tuple[str, ...]:
        """Give the names; InputError: they are not all in one message (`found`)."""
        if self._names is not None and found:
            return self._names
        names = self._match(frozenset[str]().union(*self._tried))
        remedy = "Record one publisher of all joints, or name another."
        raise InputError(self._place, f"has no message with all of {', '.join(names)}", "", remedy)

    def _match(self, listed: Iterable[str]) -> tuple[str, ...]:
        request = self._request
        return match_joint_names(self._place, sorted(listed), request.arm, request.joint_names)


def joint_values(message: BagMessage, names: Sequence[str]) -> Array | None:
    """Take joint positions (n,) by name, in any order; None: one is missing, or named twice."""
    listed = [str(name) for name in message.content.name]
    places = {name: place for place, name in enumerate(listed) if listed.count(name) == 1}
    positions = message.content.position
    found = [places.get(name, len(positions)) for name in names]
    if max(found) >= len(positions):
        return None
    return np.array([positions[place] for place in found], dtype=float)


def _require_stamps(place: str, stamps: list[int], kind: str) -> None:
    missing = sum(stamp <= 0 for stamp in stamps)
    if missing:
        found = f"{missing} of {len(stamps)} messages have no stamp in their header"
        expected = "each says when it was taken"
        remedy = "Have the driver set it; --stamps received takes the times of recording instead."
        raise InputError(place, found, expected, remedy if kind == HEADER else "Record it again.")


def pair_stamps(left: Stamps, right: Stamps) -> Index:
    """Pair the pictures of two cameras, (k, 2): each the other's nearest, in order.

    No further apart than half the shorter of the two median periods. Pictures that are not later
    than every one before are left out.
    """
    highest = (np.maximum.accumulate(t) for t in (left, right))
    kept = [np.flatnonzero(np.diff(t, prepend=t[0] - 1) > 0) for t in highest]
    a, b = left[kept[0]], right[kept[1]]
    if min(len(a), len(b)) < MIN_PAIRS:
        return np.zeros((0, 2), dtype=np.intp)
    nearest_right, nearest_left = _nearest(a, b), _nearest(b, a)
    mutual = nearest_left[nearest_right] == np.arange(len(a))
    half = min(np.median(np.diff(a)), np.median(np.diff(b))) / 2
    mutual &= np.abs(a - b[nearest_right]) <= half
    found = np.flatnonzero(mutual)
    return np.column_stack([kept[0][found], kept[1][nearest_right[found]]])


def _nearest(times: Stamps, others: Stamps) -> Index:
    after = np.clip(np.searchsorted(others, times), 1, len(others) - 1)
    before = times - others[after - 1] <= others[after] - times
    return np.asarray(after - before, dtype=np.intp)


def _describe_skew(outline: BagOutline) -> str:
    a, b = (t[outline.pairs[:, side]] for side, t in enumerate(outline.picture_times))
    skew = (b - a) / 1e6
    return (
        f"{len(skew)} pairs; right less left picture: {np.median(skew):.3f} ms, "
        f"{skew.min():.3f} to {skew.max():.3f} ms"
    )


def _seconds(stamp: int, start: int) -> str:
    """Time since the start of the session, s, to the nanosecond."""
    sign, rest = ("-" if stamp < start else ""), abs(stamp - start)
    return f"{sign}{rest // SECOND}.{rest % SECOND:09d}"


def _write_frames(outline: BagOutline, path: Path) -> None:
    left, right = outline.picture_times
    rows = (
        f"{frame},{_seconds(int(left[i]), outline.start)},{_seconds(int(right[j]), outline.start)}"
        for frame, (i, j) in enumerate(outline.pairs.tolist())
    )
    with path.open("w", encoding="utf-8", newline="\n") as file:
        file.write("frame,t_left_s,t_right_s\n")
        file.writelines(f"{row}\n" for row in rows)


def _write_streams(
    bag: Bag, request: BagRequest, outline: BagOutline, folder: Path, progress: Progress
) -> int:
    """Second pass: pictures and readings as they come; returns how many readings were written."""
    left, right, joints = (topic.name for topic in request.topics)
    wanted = [set(outline.pairs[:, side].tolist()) for side in (0, 1)]
    rate = SECOND / float(np.median(np.diff(outline.picture_times[0][outline.pairs[:, 0]])))
    with ExitStack() as stack:
        videos = [
            PictureStream(stack.enter_context(VideoWriter(folder / f"{side}.mkv", rate)),
                          outline.depth, request.image_size)
            for side in SIDES
        ]  # fmt: skip
        path = folder / "encoders.csv"
        table = stack.enter_context(path.open("w", encoding="utf-8", newline="\n"))
        readings = ReadingStream(table, request.arm.dof, outline.start)
        topics = (left, right, joints)
        for message in bag.messages(topics, lambda d, n: progress(n + d, 2 * n, "pictures")):
            if message.topic != joints:
                side = (left, right).index(message.topic)
                if message.number in wanted[side]:
                    videos[side].add(message, _place(bag, message))
                continue
            values = joint_values(message, outline.names)
            time = message.stamp if request.stamps == HEADER else message.received
            if values is not None:
                readings.add(time, values * ANGLE_UNITS[request.unit])
    readings.require_one_publisher(f"{bag.path}, {joints}")
    return readings.written


class ReadingStream:
    """Writes encoders.csv: the readings whose times rise."""

    def __init__(self, table: TextIO, joints: int, start: int) -> None:
        self._table, self._start = table, start
        self._last: tuple[int, Array] | None = None  # ns, rad
        self.written = self._late = self._leaps = 0
        table.write("t_s," + ",".join(f"q{joint}_deg" for joint in range(1, joints + 1)) + "\n")

    def add(self, time: int, q: Array) -> None:
        """Append a reading q (n,), rad, of a time, ns, unless that is not later than the last."""
        if self._last is not None:
            elapsed = time - self._last[0]
            if elapsed <= 0:
                self._late += 1
                return
            turned = np.abs((q - self._last[1] + np.pi) % (2 * np.pi) - np.pi)
            self._leaps += bool((turned > max(MAX_SPEED * elapsed / SECOND, MIN_SPIKE)).any())
        self._last, self.written = (time, q), self.written + 1
        degrees = ",".join(f"{angle:.9f}" for angle in np.rad2deg(q).tolist())
        self._table.write(f"{_seconds(time, self._start)},{degrees}\n")

    def require_one_publisher(self, place: str) -> None:
        """Refuse, by an InputError, readings that two publishers or a wrong clock have mixed."""
        count = self.written + self._late
        if self._late > MAX_LATE * count:
            found = f"{self._late} of {count} readings are not later than the one before"
            remedy = "Name another topic by --joints, or use --stamps received."
            raise InputError(place, found, "one publisher, whose stamps rise", remedy)
        if self._leaps > MAX_LATE * count:
            found = f"{self._leaps} of {count} readings leap from the one before as no arm turns"
            remedy = "Record it without the other, such as joint_state_publisher."
            raise InputError(place, found, "one publisher of the joints", remedy)


class PictureStream:
    """Writes one camera's messages to its video: all JPEGs as they are, or all decoded."""

    def __init__(self, video: VideoWriter, depth: int, size: tuple[int, int] | None) -> None:
        self._video, self._depth, self._size = video, depth, size
        self._kind: tuple[bool, int] | None = None  # a JPEG; dimensions of the array

    def add(self, message: BagMessage, place: str) -> None:
        """Append a picture.

        Raises:
            InputError: it cannot be decoded, or is of another size or kind than the rig or the
                pictures before.
        """
        data = pictures.jpeg_of(message, place)
        if data is not None:
            size = pictures.jpeg_size(data, place)
            self._require(place, (True, 0), size)
            self._video.add_jpeg(data, size)
            return
        picture = pictures.decode_message(message, place, self._depth)
        self._require(place, (False, picture.ndim), (picture.shape[1], picture.shape[0]))
        self._video.add(picture)

    def _require(self, place: str, kind: tuple[bool, int], size: tuple[int, int]) -> None:
        self._size = self._size or size
        self._kind = self._kind or kind
        if size != self._size:
            found = f"is {size[0]} x {size[1]} px"
            expected = "{} x {} are expected, as of the rig".format(*self._size)
            raise InputError(place, found, expected, "Use the rig.toml of these cameras.")
        if kind != self._kind:
            expected = "all pictures of a topic have one encoding"
            raise InputError(place, "is encoded otherwise than those before", expected,
                             "Record it again.")  # fmt: skip


def _place(bag: Bag, message: BagMessage) -> str:
    return f"{bag.path}, {message.topic}, message {message.number}"
