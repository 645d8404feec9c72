"""The keys of grab.toml, as the file has them: millimetres, degrees; meanings in docs/grab.md."""

import msgspec

Triple = tuple[float, float, float]


class TableTable(msgspec.Struct, kw_only=True):
    """The keys of [table]."""

    height_mm: float
    clearance_mm: float = 30.0
    finger_clearance_mm: float = 3.0


class WorkspaceTable(msgspec.Struct, kw_only=True):
    """The keys of [workspace]."""

    lower_mm: Triple
    upper_mm: Triple


class GripperTable(msgspec.Struct, kw_only=True):
    """The keys of [gripper]."""

    opening_mm: float
    position_mm: Triple
    rotation_deg: Triple = (0.0, 0.0, 0.0)
    tips_mm: float
    finger_length_mm: float
    radius_mm: float


class ApproachTable(msgspec.Struct, kw_only=True):
    """The keys of [approach]."""

    direction: Triple = (0.0, 0.0, -1.0)
    height_mm: float = 120.0
    speed_mm_s: float = 50.0
    acceleration_mm_s2: float = 200.0
    jerk_mm_s3: float = 1000.0
    hidden_mm: float = 60.0


class MotionTable(msgspec.Struct, kw_only=True):
    """The keys of [motion]."""

    share: float = 0.1
    link_radius_mm: float = 70.0
    camera_clearance_mm: float = 100.0
    home_deg: list[float] | None = None


class AccuracyTable(msgspec.Struct, kw_only=True):
    """The keys of [accuracy]."""

    robot_standard_uncertainty_mm: float
    coverage: float = 0.95


class StillTable(msgspec.Struct, kw_only=True):
    """The keys of [still]."""

    speed_mm_s: float = 10.0
    for_s: float = 0.5


class WatchdogTable(msgspec.Struct, kw_only=True):
    """The keys of [watchdog]."""

    stale_s: float = 0.3
    lost_s: float = 1.0
    joints_s: float = 0.5
    moving_s: float = 60.0


class GrabTable(msgspec.Struct, kw_only=True):
    """The keys of grab.toml."""

    format: int
    table: TableTable
    workspace: WorkspaceTable
    gripper: GripperTable
    approach: ApproachTable = msgspec.field(default_factory=ApproachTable)
    motion: MotionTable = msgspec.field(default_factory=MotionTable)
    accuracy: AccuracyTable
    still: StillTable = msgspec.field(default_factory=StillTable)
    watchdog: WatchdogTable = msgspec.field(default_factory=WatchdogTable)
