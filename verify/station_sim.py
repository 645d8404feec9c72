"""What a station asks of a simulation: which scenario, how fast, and what goes wrong when."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from verify.cameras import Camera, CameraSettings
from verify.devices import Encoders, Pan
from verify.marker import Marker
from verify.rig import Rig

HAPPENINGS = (
    "encoder_jump",  # joint, degrees: its readings are off by so much
    "encoder_silent",  # no readings
    "encoder_reset",  # the controller's clock starts anew
    "camera_gone",  # camera: it is unplugged
    "camera_stalls",  # camera: it is there and delivers nothing
    "leds_covered",  # led: that one, or all
    "lamp_on",  # a lamp beside the marker
    "pan_gone",  # the bases' board is unplugged
)


@dataclass(frozen=True, slots=True)
class SimEvent:
    """Something that happens to the simulated devices."""

    what: str  # one of HAPPENINGS
    at: float  # s after the start
    duration: float | None = None  # s; None: for good
    joint: int | None = None  # counted from 1
    angle: float = 0.0  # rad
    camera: str = "both"  # left, right, both
    led: str | None = None  # None: all

    def present(self, t: float) -> bool:
        """Whether it is so at t, s after the start."""
        return self.at <= t and (self.duration is None or t < self.at + self.duration)

    def strikes(self, side: int) -> bool:
        """Whether it befalls the left (0) or right (1) camera."""
        return self.camera in ("both", ("left", "right")[side])


@dataclass(frozen=True, slots=True)
class SimSettings:
    """Which simulated station it is."""

    scenario: str  # a built-in one's name, or a path
    speed: float = 1.0  # times real time
    events: tuple[SimEvent, ...] = ()


class Simulated(Protocol):
    """The simulated hardware, and what its owner believes of it."""

    @property
    def robot(self) -> str:
        """Its arm, as a station file names one."""
        ...

    @property
    def rig(self) -> Rig:
        """Its calibration."""
        ...

    @property
    def marker(self) -> Marker:
        """Its LEDs."""
        ...

    def camera(self, side: int, settings: CameraSettings) -> Camera:
        """Open the left (0) or right (1) camera."""
        ...

    def encoders(self, rate: float | None) -> Encoders:
        """Open the encoders; rate in Hz, None for the scenario's own."""
        ...

    def pan(self) -> Pan:
        """Open the turning bases."""
        ...


Simulate = Callable[[SimSettings], Simulated]
