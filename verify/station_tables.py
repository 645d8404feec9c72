"""The keys of a station file, as the file has them: degrees, milliseconds, paths."""

import msgspec

from verify.session_file import (
    ClockTable,
    EnvironmentTable,
    RobotFramesTable,
    ToleranceTable,
)


class CameraTable(msgspec.Struct, kw_only=True):
    """The keys of [left] and [right]."""

    source: int | str
    size: tuple[int, int] | None = None
    rate_hz: float | None = None
    format: str | None = None
    exposure_ms: float | None = None
    gain: float | None = None
    white_balance_k: float | None = None
    grey: bool | None = None
    delay_ms: float = 0.0


class EncodersTable(msgspec.Struct, kw_only=True, omit_defaults=True):
    """The keys of [encoders]; which of them have a meaning depends on the driver."""

    driver: str
    resolution_deg: float | None = None
    time_standard_uncertainty_s: float | None = None
    sign: list[int] | None = None
    offset_deg: list[float] | None = None
    port: str | None = None
    baud: int | None = None
    data_bits: int | None = None
    parity: str | None = None
    stop_bits: int | None = None
    rts_cts: bool | None = None
    terminator: str | None = None
    pause_ms: float | None = None
    timeout_s: float | None = None
    robot_type: str | None = None
    cycle_ms: float | None = None
    checksum: str | None = None
    rate_hz: float | None = None
    unit: str | None = None
    latch_span_us: float | None = None
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


class PanTable(msgspec.Struct, kw_only=True, omit_defaults=True):
    """The keys of [pan]."""

    driver: str = "fixed"
    follow: bool = False
    sign: list[int] | None = None
    offset_deg: list[float] | None = None
    port: str | None = None
    baud: int | None = None
    checksum: str | None = None
    rate_hz: float | None = None
    unit: str | None = None
    latch_span_us: float | None = None


class AlarmTable(msgspec.Struct, kw_only=True):
    """The keys of [alarm]."""

    false_alarms_per_hour: float = 0.1
    command: str | None = None
    mqtt: str | None = None
    prometheus: str | None = None


class RecordingTable(msgspec.Struct, kw_only=True):
    """The keys of [recording]."""

    folder: str = "recordings"
    name: str = "{robot}-%Y-%m-%d-%H%M%S"


class EventTable(msgspec.Struct, kw_only=True):
    """The keys of [[sim.event]]."""

    what: str
    at_s: float
    for_s: float | None = None
    joint: int | None = None
    degrees: float = 0.0
    camera: str = "both"
    led: str | None = None


class SimTable(msgspec.Struct, kw_only=True):
    """The keys of [sim]."""

    scenario: str = "multi_joint_rv_3sd"
    speed: float = 1.0
    event: list[EventTable] = msgspec.field(default_factory=list)


class StationTable(msgspec.Struct, kw_only=True):
    """The keys of a station file."""

    format: int
    robot: str
    description: str = ""
    rig: str
    marker: str
    left: CameraTable
    right: CameraTable
    encoders: EncodersTable
    pan: PanTable = msgspec.field(default_factory=PanTable)
    tolerance: ToleranceTable | None = None
    clock: ClockTable | None = None
    alarm: AlarmTable = msgspec.field(default_factory=AlarmTable)
    recording: RecordingTable = msgspec.field(default_factory=RecordingTable)
    environment: EnvironmentTable = msgspec.field(default_factory=EnvironmentTable)
    robot_frames: RobotFramesTable = msgspec.field(default_factory=RobotFramesTable)
    sim: SimTable = msgspec.field(default_factory=SimTable)
