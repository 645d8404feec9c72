"""The life cycle of every device (open, read, state, close), and its readings, settings and states.

Times are seconds on the host's monotonic clock unless a field names another one. Drivers name
their limits alike, in s:

    CONNECT_TIMEOUT   until a connection is made
    SEND_TIMEOUT      until bytes are sent
    ANSWER_TIMEOUT    from a request to its answer
    READ_TIMEOUT      that `Device.read` waits while nothing arrives
    SILENCE_TIMEOUT   without a reading before an open device counts as silent
    START_TIMEOUT     until a process is ready
    JOIN_TIMEOUT      that a thread or process may take to end by itself
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol, TypeVar

from verify.core.records import Array, Image, StereoPair

READ_TIMEOUT = 0.2  # s, of every camera; lines have the one of `devices.ports`

Readings_co = TypeVar("Readings_co", covariant=True)
State_co = TypeVar("State_co", covariant=True)


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
    lost: int  # readings that the device numbered and that never came
    bad: Mapping[str, int]  # what was dropped: reason -> how often
    sentence: str  # what there is to say, in words
    program_running: bool | None = None  # of the robot, where the device tells


@dataclass(frozen=True, slots=True)
class CapturedImage:
    """A picture as a camera's source gives it."""

    t: float  # s, mid-exposure as well as the platform tells
    t_uncertainty: float  # s: half-width about t, within which it was taken
    image: Image  # (h, w) grey or (h, w, 3) BGR
    raw: bytes | None  # the picture as the camera encoded it (JPEG), where it did


@dataclass(frozen=True, slots=True)
class CameraFrame(CapturedImage):
    """A picture among those of its camera; t is on the host's monotonic clock."""

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
    lost: int  # pictures that nobody read in time
    sentence: str  # what there is to say, in words
    refused: tuple[RefusedSetting, ...] = ()
    ended: bool = False  # a file that is over: no picture will come


class Device(Protocol[Readings_co, State_co]):
    """A device that is read: a camera, encoders, turning camera bases.

    Its constructor takes the settings and returns at once. The driver opens the device by itself,
    and again whenever it was lost. Neither `read` nor `state` raises for what goes wrong on the
    line: `state` reports it.
    """

    def read(self) -> Readings_co:
        """Give what has arrived since the last call; waits for at most the driver's READ_TIMEOUT.

        Encoders and bases give a list of readings, oldest first, and may wait for CONNECT_TIMEOUT
        an address while they connect. A camera gives its oldest picture that was not read yet, or
        None.
        """

    def state(self) -> State_co:
        """Describe the state of the device; sends nothing to it."""

    def close(self) -> None:
        """Release the device; it is not opened again."""


CameraDevice = Device[CameraFrame | None, CameraState]
EncoderDevice = Device[list[EncoderReading], DeviceState]
PanDevice = Device[list[PanReading], DeviceState]
