"""Protocols and records that the live loop shares with listeners and devices; alarms."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import robots
from verify.core.fiducials import Marker
from verify.core.records import Array
from verify.core.rig import Rig
from verify.devices.protocols import CameraDevice, EncoderDevice, PanDevice
from verify.io.session.keys import Clock
from verify.live.joint_row import JointRow

ExpectedPoses = Callable[[float], Sequence[Array]]  # rig_T_flange from the readings, at a time, s


def format_error_deg(error: float, standard_uncertainty: float) -> str:
    """Write an error and its expanded uncertainty (k = 2) in degrees; both are given in rad."""
    digits = 2 if standard_uncertainty >= math.radians(0.01) else 3
    value, doubt = math.degrees(error), 2 * math.degrees(standard_uncertainty)
    sign = "−" if value < 0 else "+"
    return f"{sign}{abs(value):.{digits}f}° ± {doubt:.{digits}f}° (k = 2)"


@dataclass(frozen=True, slots=True)
class Alarm:
    """One alarm."""

    number: int  # counts from 1
    kind: str  # change, tolerance, target, device, defect
    began: float  # s since the epoch
    t: float  # s, cameras' clock, of the pair that raised it
    text: str  # one sentence
    joints: tuple[int, ...] = ()  # counted from 1: the likeliest, then those that may be meant too
    error: float | None = None  # rad
    standard_uncertainty: float | None = None  # rad
    device: str | None = None
    ended: float | None = None  # s since the epoch; None while it stands; a change is an event
    revised: bool = False  # a revision of an alarm that was raised before

    def fields(self) -> dict[str, Any]:
        """Give the alarm as JSON has it, in degrees and seconds."""
        return {
            "alarm": self.number,
            "kind": self.kind,
            "began_s": self.began,
            "t_s": self.t,
            "text": self.text,
            "joint": self.joints[0] if self.joints else None,
            "not_told_apart_from": list(self.joints[1:]),
            "error_deg": None if self.error is None else math.degrees(self.error),
            "standard_uncertainty_deg": None
            if self.standard_uncertainty is None
            else math.degrees(self.standard_uncertainty),
            "device": self.device,
            "ended_s": self.ended,
            "revised": self.revised,
        }


class Listener(Protocol):
    """Receives rows and alarms, in a thread of its own: it may take its time.

    Whoever derives from it takes no rows, and has nothing to end, unless it says so.
    """

    def row(self, row: JointRow, statistic: Array) -> None:
        """Take a pair's outcome, causal and then `settled`; of too many some are left out."""
        del row, statistic

    def alarm(self, alarm: Alarm) -> None:
        """Take an alarm that is new, revised, or over."""

    def close(self) -> None:
        """End: nothing more will come."""
        return


@dataclass(frozen=True, slots=True)
class LiveDevices:
    """The open devices of a run."""

    left: CameraDevice
    right: CameraDevice
    encoders: EncoderDevice
    pan: PanDevice | None = None  # None: the bases stand as the rig says
    # orders both bases to angles as read, rad; None: they are not turned from here
    turn: Callable[[float, float], bool] | None = None
    files: bool = False  # the cameras are files, which wait until their pictures are measured


@dataclass(frozen=True, slots=True)
class MonitoredRobot:
    """The robot that is watched, with the cameras' calibration."""

    arm: robots.Arm
    rig: Rig
    marker: Marker
    clock: Clock | None  # None: the offset is estimated from the motion
    resolution: float | None = None  # rad, of the readings
    time_uncertainty: float | None = None  # s, of the readings; None: the driver's
