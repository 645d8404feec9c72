"""What the chain needs from a camera, and no more."""

from dataclasses import dataclass
from typing import Protocol

from verify.records import Image, StereoPair

READ_LIMIT = 0.2  # s: `Camera.read` comes back within it, with a picture or without


@dataclass(frozen=True, slots=True)
class CameraFrame:
    """One picture and when it was taken."""

    t: float  # s, host's monotonic clock, mid-exposure as well as the platform tells
    t_uncertainty: float  # s: half-width about t, within which it was taken
    image: Image  # (h, w) grey or (h, w, 3) BGR
    raw: bytes | None  # the picture as the camera encoded it (JPEG), where it did
    sequence: int  # counts every picture that came; a gap is pictures that nobody read in time


@dataclass(frozen=True, slots=True)
class TakenPair(StereoPair):
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
class Refusal:
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
    refused: tuple[Refusal, ...] = ()
    ended: bool = False  # a file that is over: no picture will come


class Camera(Protocol):
    """Pictures as they come."""

    def read(self) -> CameraFrame | None:
        """Give the oldest picture that was not read yet; None after READ_LIMIT without one.

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
