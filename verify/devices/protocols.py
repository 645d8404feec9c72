"""What the chain needs from a device, and no more.

What the chain needs from a camera, and no more.

Cameras: pictures with their time, settings asked for and read back, states in words.

One module a driver. Times are seconds on the host's monotonic clock, mid-exposure as well as the
platform tells. A camera that is gone is looked for again by its own driver.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

from verify.core.records import Array, Image, StereoPair


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


class EncoderDevice(Protocol):
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


class PanDevice(Protocol):
    """Angles of both camera bases as they arrive."""

    def read(self) -> list[PanReading]:
        """Give what has arrived since the last call; the promises of `EncoderDevice.read` hold."""
        ...

    def state(self) -> DeviceState:
        """Say how the device is; asks nothing of it."""
        ...

    def close(self) -> None:
        """Leave the device alone, in good order."""
        ...


READ_TIMEOUT = 0.2  # s: `CameraDevice.read` comes back within it, with a picture or without


@dataclass(frozen=True, slots=True)
class CameraFrame:
    """One picture and when it was taken."""

    t: float  # s, host's monotonic clock, mid-exposure as well as the platform tells
    t_uncertainty: float  # s: half-width about t, within which it was taken
    image: Image  # (h, w) grey or (h, w, 3) BGR
    raw: bytes | None  # the picture as the camera encoded it (JPEG), where it did
    sequence: int  # counts every picture that came; a gap is pictures that nobody read in time


@dataclass(frozen=True, slots=True)
class CapturedPair(StereoPair):
    """A stereo pair as two cameras delivered it."""

    left_raw: bytes | None = None  # the JPEG that `left` was decoded from, where it was one
    right_raw: bytes | None = None


@dataclass(frozen=True, slots=True)
class CameraSettings:
    """What a camera is asked for; None leaves its own."""

    source: int | str  # index, device path, URL, video file, or "sim"
    size: tuple[int, int] | None = None  # width, height, px
    rate: float | None = None  # Hz
    format: str | None = None  # four letters, such as MJPG, YUYV, GREY
    exposure: float | None = None  # s
    gain: float | None = None  # in the camera's own unit
    white_balance: float | None = None  # K
    grey: bool | None = None  # one channel is kept; None: as the camera delivers
    delay: float = 0.0  # s, from mid-exposure to the picture's arrival, where it is known


@dataclass(frozen=True, slots=True)
class RefusedSetting:
    """A setting that the camera did not take."""

    setting: str
    asked: str
    got: str

    def __str__(self) -> str:
        return f"{self.setting} {self.asked} refused, it is {self.got}"


@dataclass(frozen=True, slots=True)
class CameraState:
    """How a camera is, for the page, the log and `verify doctor`."""

    connected: bool
    age: float | None  # s since the last picture; None before the first
    frames: int  # pictures so far
    lost: int  # pictures that nobody read in time
    sentence: str  # what there is to say, in words
    size: tuple[int, int] | None = None  # width, height, px, of the last picture
    rate: float | None = None  # Hz, of the last second
    refused: tuple[RefusedSetting, ...] = ()
    ended: bool = False  # a file that is over: no picture will come


class CameraDevice(Protocol):
    """Pictures as they come."""

    def read(self) -> CameraFrame | None:
        """Give the oldest picture that was not read yet; None after READ_TIMEOUT without one.

        Whatever goes wrong is told by `state` and never raised; finding a camera again is its own
        affair.
        """
        ...

    def state(self) -> CameraState:
        """Say how the camera is; asks nothing of it."""
        ...

    def close(self) -> None:
        """Let go of the camera."""
        ...


__all__ = [
    "READ_TIMEOUT",
    "CameraDevice",
    "CameraFrame",
    "CameraSettings",
    "CameraState",
    "CapturedPair",
    "RefusedSetting",
]
