"""The state of a run as the page shows it, in degrees, millimetres and milliseconds."""

import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from robots.transforms import invert
from verify.core.records import Array, Image, Sighting, StereoPair
from verify.core.rig import Rig
from verify.live.alarms.joints import AlarmLimits
from verify.live.joint_row import JointRow
from verify.live.outputs.metrics import exposition
from verify.live.page.scene import image_size, joint_origins, millimetres, pose_fields, small_jpeg
from verify.live.protocols import MonitoredRobot
from verify.live.snapshot import MAX_TEXT_LENGTH
from verify.live.state import LiveState


@dataclass(frozen=True, slots=True)
class RunFacts:
    """What the page says of the run beside its figures."""

    robot: str
    description: str
    limits: AlarmLimits
    duration: float | None = None  # s, of the watch; None: until it is ended


class RunPageSource:
    """Reads a run's state; nothing waits for it."""

    def __init__(self, state: LiveState, subject: MonitoredRobot, facts: RunFacts) -> None:
        self._state, self._subject, self._facts = state, subject, facts
        self._row = 0
        self._frame: int | None = None
        self._began = time.time()

    def hello(self) -> dict[str, Any]:
        """What never changes."""
        subject, facts = self._subject, self._facts
        tolerance = facts.limits.tolerance
        return {
            "mode": "run",
            "run": f"{self._began:.3f}",
            "ends_s": None if facts.duration is None else round(self._began + facts.duration, 1),
            "title": facts.robot,
            "description": facts.description[:MAX_TEXT_LENGTH],
            "joints": subject.arm.dof,
            "leds": list(subject.marker.names),
            "tolerance_deg": None if tolerance is None else _degrees(tolerance),
            "false_alarms_per_hour": facts.limits.false_alarms_per_hour,
            "cameras": camera_poses(subject.rig, None),
        }

    def rows(self) -> list[dict[str, Any]]:
        """Rows since the last call; the newest with what the scene draws."""
        new = self._state.rows_after(self._row)
        if not new:
            return []
        self._row = new[-1][0]
        rows = [self._fields(row) for _, row in new]
        rows[-1]["scene"] = self._scene(new[-1][1])
        return rows

    def state(self) -> dict[str, Any]:
        """How everything is."""
        now = self._state.snapshot()
        p50, p99 = now.latency or (None, None)
        return {
            "rate_hz": round(now.rate, 1),
            "pairs": now.pairs,
            "measured": now.measured,
            "dropped": dict(now.dropped),
            "statuses": self._state.statuses(),
            "latency_p50_ms": None if p50 is None else round(p50 * 1e3, 1),
            "latency_p99_ms": None if p99 is None else round(p99 * 1e3, 1),
            "recording": now.recording,
            "devices": [asdict(line) for line in now.devices],
        }

    def alarms(self) -> Sequence[dict[str, Any]]:
        """All that are remembered, newest first."""
        return [alarm.fields() for alarm in self._state.snapshot().alarms]

    def pictures(self) -> Sequence[tuple[int, dict[str, Any], bytes]]:
        """The newest pair, if it was not given yet, scaled down and encoded once for all."""
        latest = self._state.pictures
        if latest is None or latest[0].frame == self._frame:
            return ()
        pair, measurement = latest
        self._frame = pair.frame
        return [
            (0, _led_fields(pair.left, measurement.left), small_jpeg(pair.left)),
            (1, _led_fields(pair.right, measurement.right), small_jpeg(pair.right)),
        ]

    def metrics(self) -> str:
        """Text for Prometheus."""
        return exposition(self._state)

    def _fields(self, row: JointRow) -> dict[str, Any]:
        clock = row.clock
        return {
            "frame": row.frame,
            "t_s": round(row.t, 6),
            "status": row.status,
            "leds": row.leds_seen,
            "error_deg": _degrees(row.error),
            "u_deg": _degrees(row.uncertainty),
            "measured_deg": _degrees(row.measured),
            "encoder_deg": _degrees(row.encoder),
            "clock": None if clock is None else clock.source,
            "offset_s": None if clock is None else round(clock.offset, 6),
            "offset_u_s": None if clock is None else clock.standard_uncertainty,
        }

    def _scene(self, row: JointRow) -> dict[str, Any]:
        """Measured and encoder-derived arm and LEDs, and the cameras; base frame, mm."""
        latest = self._state.pictures
        pair = None if latest is None else latest[0]
        scene: dict[str, Any] = {"cameras": camera_poses(self._subject.rig, pair)}
        leds = self._subject.marker.leds
        for name, q, pose in (
            ("measured", row.measured, row.base_T_measured),
            ("encoder", row.encoder, row.base_T_encoder),
        ):
            part: dict[str, Any] = {}
            if np.all(np.isfinite(q)):
                part["arm_mm"] = millimetres(joint_origins(self._subject.arm, q))
            if pose is not None:
                part["leds_mm"] = millimetres(leds @ pose[:3, :3].T + pose[:3, 3])
            scene[name] = part
        snapshot = self._state.snapshot()
        if snapshot.statistic is not None:
            scene["statistic"] = [round(float(s), 3) for s in snapshot.statistic]
        return scene


def _degrees(angles: Array) -> list[float | None]:
    """Angles for JSON, which knows no nan."""
    return [round(a, 5) if np.isfinite(a) else None for a in np.rad2deg(angles).tolist()]


def camera_poses(rig: Rig, pair: StereoPair | None) -> list[dict[str, Any]]:
    """Write both cameras' poses in the robot's base as JSON has them, left and right.

    They stand as their bases did for the pair; without one, as the rig file says.
    """
    pans = (rig.left.pan, rig.right.pan) if pair is None else (pair.pan_left, pair.pan_right)
    base_T_rig = invert(rig.rig_T_base)
    return [
        pose_fields(base_T_rig @ camera.rig_T_camera(pan))
        for camera, pan in zip((rig.left, rig.right), pans, strict=True)
    ]


def _led_fields(image: Image, sighting: Sighting | None) -> dict[str, Any]:
    leds = [] if sighting is None else list(zip(sighting.led, sighting.centre, strict=True))
    places = [
        {"led": int(led), "x": round(float(x), 2), "y": round(float(y), 2)} for led, (x, y) in leds
    ]
    return image_size(image) | {"leds": places}
