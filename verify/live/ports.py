"""What the loop needs of others, and no more."""

import itertools
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Protocol

import robots
from verify.cameras import Camera
from verify.devices import EncoderReading, Encoders, Pan
from verify.live.alarms import Alarm
from verify.live.joint_row import JointRow
from verify.marker import Marker
from verify.records import Array, StereoPair
from verify.rig import Rig
from verify.session_file import Clock

Numbers = itertools.count  # alarms are numbered through, whoever raises them


class RecorderState(Protocol):
    """How a recording is."""

    @property
    def recording(self) -> bool:
        """It goes on."""
        ...

    @property
    def sentence(self) -> str:
        """What there is to say."""
        ...


class Recorder(Protocol):
    """Puts evidence on the disk before anything is computed from it."""

    def keep(
        self, pairs: Iterator[StereoPair], meanwhile: Callable[[StereoPair], None]
    ) -> Iterator[StereoPair]:
        """Record pairs as they pass; the other is called while each is being written."""
        ...

    def through(self, frame: int) -> None:
        """Note that the pair of that number is measured and compared."""
        ...

    def reading(self, reading: EncoderReading) -> EncoderReading:
        """Record a reading; gives it as the recording has it."""
        ...

    def state(self) -> RecorderState:
        """Say how the recording is."""
        ...

    def close(self) -> None:
        """Write what is under way and close the session."""
        ...


class Listener(Protocol):
    """Is told what happens, in a thread of its own: it may take its time."""

    def row(self, row: JointRow, statistic: Array) -> None:
        """Take a pair's outcome; some may be left out when there are too many."""
        ...

    def alarm(self, alarm: Alarm) -> None:
        """Take an alarm that is new, revised, or over."""
        ...

    def close(self) -> None:
        """Nothing more will come."""
        ...


@dataclass(frozen=True, slots=True)
class Devices:
    """What is looked at and listened to."""

    left: Camera
    right: Camera
    encoders: Encoders
    pan: Pan | None = None  # None: the bases stand as the rig says
    # orders both bases to angles as read, rad; None: they are not turned from here
    turn: Callable[[float, float], bool] | None = None
    files: bool = False  # the cameras are files, which wait until their pictures are measured


@dataclass(frozen=True, slots=True)
class Subject:
    """The robot that is watched, and what is known of it and of the cameras."""

    arm: robots.Arm
    rig: Rig
    marker: Marker
    clock: Clock | None  # None: the offset is estimated from the motion
    resolution: float | None = None  # rad, of the readings
    time_uncertainty: float | None = None  # s, of the readings; None: as the driver says
