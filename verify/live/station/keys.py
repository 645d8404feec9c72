"""The keys of a station file in its own units (degrees, ms, paths), and of a simulation."""

from collections.abc import Callable
from typing import Annotated, Protocol

import msgspec

from verify.core.fiducials import Marker
from verify.core.rig import Rig
from verify.devices.protocols import CameraDevice, CameraSettings, EncoderDevice, PanDevice
from verify.io.session import keys
from verify.io.toml import NotNegative, Positive

Pixels = Annotated[int, msgspec.Meta(ge=1)]
Baud = Annotated[int, msgspec.Meta(ge=1, le=20_000_000)]
_HOST = r"(\[[0-9A-Fa-f:.]+\]|[^\s:/@\[\]]+)"  # a name, or an address
_PORT = r"(?!6553[6-9]|655[4-9]\d|65[6-9]\d\d|6[6-9]\d{3}|[7-9]\d{4})[0-9]{1,5}"  # to 65535
HOST_AND_PORT = f"{_HOST}(:{_PORT})"  # "?" behind it: the port may be missing
SECURITY_KEYS = ("certificate", "private_key", "server_certificate", "security_policy")  # OPC UA


class StationCameraTable(msgspec.Struct, kw_only=True):
    """The keys of [left] and [right]."""

    source: Annotated[int, msgspec.Meta(ge=0)] | str
    size: tuple[Pixels, Pixels] | None = None
    rate_hz: NotNegative | None = None
    format: str | None = None
    exposure_ms: Positive | None = None
    gain: float | None = None
    white_balance_k: Positive | None = None
    grey: bool | None = None
    delay_ms: NotNegative = 0.0


class AngleDeviceTable(msgspec.Struct, kw_only=True, omit_defaults=True):
    """The keys of a device that tells angles: of [encoders] and of [pan]."""

    sign: list[int] | None = None
    offset_deg: list[float] | None = None
    port: str | None = None
    baud: Baud | None = None
    checksum: str | None = None
    rate_hz: float | None = None
    unit: str | None = None
    latch_span_us: float | None = None


class StationEncodersTable(AngleDeviceTable, kw_only=True, omit_defaults=True):
    """The keys of [encoders]; which of them have a meaning depends on the driver."""

    driver: str
    resolution_deg: NotNegative | None = None
    time_standard_uncertainty_s: NotNegative | None = None
    data_bits: int | None = None
    parity: str | None = None
    stop_bits: int | None = None
    rts_cts: bool | None = None
    terminator: str | None = None
    pause_ms: float | None = None
    timeout_s: float | None = None
    robot_type: str | None = None
    cycle_ms: float | None = None
    path: str | None = None
    columns: list[str] | None = None
    separator: str | None = None
    pattern: str | None = None
    skip: str | None = None
    time_unit: str | None = None
    tick_rate_hz: float | None = None
    wraps_after: float | None = None
    angle_unit: str | None = None
    counts_per_degree: list[float] | None = None
    latency_ms: float | None = None
    at_start: str | None = None
    at_end: str | None = None
    topic: str | None = None
    joint_names: list[str] | None = None
    nodes: list[str] | None = None
    stamp: str | None = None
    certificate: str | None = None
    private_key: str | None = None
    server_certificate: str | None = None
    security_policy: str | None = None
    user: str | None = None


class PanTable(AngleDeviceTable, kw_only=True, omit_defaults=True):
    """The keys of [pan]."""

    driver: str = "fixed"
    follow: bool = False


class AlarmTable(msgspec.Struct, kw_only=True):
    """The keys of [alarm]: when an alarm is raised, and where it goes."""

    false_alarms_per_hour: float = 0.1
    command: str | None = None  # called with the alarm as JSON
    mqtt: str | None = None  # mqtt://HOST:PORT/TOPIC
    prometheus: str | None = None  # HOST:PORT where metrics are served


class StationRecordingTable(msgspec.Struct, kw_only=True):
    """The keys of [recording]."""

    folder: str = "recordings"
    name: str = "{robot}-%Y-%m-%d-%H%M%S"


EVENT_KINDS = (
    "encoder_jump",  # joint, degrees: its readings are off by so much
    "encoder_silent",  # no readings
    "encoder_reset",  # the controller's clock starts anew
    "camera_gone",  # camera: it is unplugged
    "camera_stalls",  # camera: it is there and delivers nothing
    "leds_covered",  # led: that one, or all
    "lamp_on",  # a lamp beside the marker
    "pan_gone",  # the bases' board is unplugged
)


class SimEvent(msgspec.Struct, frozen=True, rename={"at": "at_s", "duration": "for_s"}):
    """[[sim.event]]: something that happens to the simulated devices."""

    what: str  # one of EVENT_KINDS
    at: NotNegative  # s after the start
    duration: NotNegative | None = None  # s; None: for good
    joint: int | None = None  # counted from 1
    degrees: float = 0.0
    camera: str = "both"  # left, right, both
    led: str | None = None  # None: all

    def present(self, t: float) -> bool:
        """Whether it is so at t, s after the start."""
        return self.at <= t and (self.duration is None or t < self.at + self.duration)

    def strikes(self, side: int) -> bool:
        """Whether it befalls the left (0) or right (1) camera."""
        return self.camera in ("both", ("left", "right")[side])


class SimSettings(msgspec.Struct, frozen=True, rename={"events": "event"}):
    """[sim]: which simulated station it is."""

    scenario: str = "multi_joint_rv_3sd"  # a built-in one's name, or a path
    speed: Positive = 1.0  # times real time
    events: tuple[SimEvent, ...] = ()


class StationTable(msgspec.Struct, kw_only=True):
    """The keys of a station file."""

    format: int
    robot: str
    description: str = ""
    rig: str
    marker: str
    left: StationCameraTable
    right: StationCameraTable
    encoders: StationEncodersTable
    pan: PanTable = msgspec.field(default_factory=PanTable)
    tolerance: keys.ToleranceTable | None = None
    clock: keys.Clock | None = None
    alarm: AlarmTable = msgspec.field(default_factory=AlarmTable)
    recording: StationRecordingTable = msgspec.field(default_factory=StationRecordingTable)
    environment: keys.EnvironmentTable = msgspec.field(default_factory=keys.EnvironmentTable)
    certificate: keys.CertificateTable = msgspec.field(default_factory=keys.CertificateTable)
    robot_frames: keys.RobotFramesTable = msgspec.field(default_factory=keys.RobotFramesTable)
    sim: SimSettings = SimSettings()


class SimulatedDevices(Protocol):
    """Simulated cameras on turning bases."""

    def camera(self, side: int, settings: CameraSettings) -> CameraDevice:
        """Open the left (0) or right (1) camera."""

    def pan(self) -> PanDevice:
        """Open the turning bases."""


class SimulatedHardware(SimulatedDevices, Protocol):
    """The simulated robot with its cameras, and its owner's description of them."""

    @property
    def robot(self) -> str:
        """Its arm, as a station file names one."""

    @property
    def rig(self) -> Rig:
        """Its calibration."""

    @property
    def marker(self) -> Marker:
        """Its LEDs."""

    def encoders(self, rate: float | None) -> EncoderDevice:
        """Open the encoders; rate in Hz, None for the scenario's own."""


Simulate = Callable[[SimSettings], SimulatedHardware]
