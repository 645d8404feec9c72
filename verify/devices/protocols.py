"""What the chain needs from a device, and no more."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

from verify.records import Array


@dataclass(frozen=True, slots=True)
class EncoderReading:
    """All joints at one instant, as the robot's own encoders tell them."""

    t: float  # s, controller's clock; the host's, mid-transaction, where the controller sends none
    t_host: float  # s, host's monotonic clock, when the last byte was in hand: never too early
    half_width: float  # s: the joints were read within ± this of t (uniform)
    segment: int  # rises when the controller's clock starts anew: times compare within one only
    q: Array  # (joints,), rad, the robot file's own joint angles


@dataclass(frozen=True, slots=True)
class PanReading:
    """Both camera bases at one instant."""

    t: float  # s, clock of the pan bases' board
    t_host: float  # s, host's monotonic clock, when the last byte was in hand
    half_width: float  # s
    segment: int
    pan: Array  # (2,), rad, left and right, as read; the rig adds pan_zero
    moving: bool  # pictures taken now are marked, not measured


@dataclass(frozen=True, slots=True)
class DeviceState:
    """How a device is, for the page, the log and `verify doctor`."""

    connected: bool
    age: float | None  # s since the last good reading; None before the first
    readings: int  # good ones so far
    lost: int  # readings that the device numbered and that never came
    bad: Mapping[str, int]  # what was dropped: reason -> how often
    sentence: str  # what there is to say, in words
    program_running: bool | None = None  # of the robot, where the device tells


class Encoders(Protocol):
    """Joint readings as they arrive: controller's clock, host's clock, angles in radians."""

    def read(self) -> list[EncoderReading]:
        """Give what has arrived since the last call, oldest first.

        Waits for at most 20 ms, and for at most 1 s an address while it connects. Whatever goes
        wrong on the line is told by `state` and never raised; connecting again is its own affair.
        """
        ...

    def state(self) -> DeviceState:
        """Say how the device is; asks nothing of it."""
        ...

    def close(self) -> None:
        """Leave the device alone, in good order."""
        ...


class Pan(Protocol):
    """Angles of both camera bases as they arrive."""

    def read(self) -> list[PanReading]:
        """Give what has arrived since the last call; the promises of `Encoders.read` hold."""
        ...

    def state(self) -> DeviceState:
        """Say how the device is; asks nothing of it."""
        ...

    def close(self) -> None:
        """Leave the device alone, in good order."""
        ...
