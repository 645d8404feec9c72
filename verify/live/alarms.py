"""One alarm: what it is, whom it names, how it is told."""

import math
from dataclasses import dataclass
from typing import Any


def in_degrees(error: float, standard_uncertainty: float) -> str:
    """Word an error and its uncertainty (rad) with as many digits as it has."""
    digits = 2 if standard_uncertainty >= math.radians(0.01) else 3
    value, doubt = math.degrees(error), math.degrees(standard_uncertainty)
    sign = "−" if value < 0 else "+"
    return f"{sign}{abs(value):.{digits}f}° ± {doubt:.{digits}f}° (1σ)"


@dataclass(frozen=True, slots=True)
class Alarm:
    """One alarm, as it is told and kept."""

    number: int  # counts from 1
    kind: str  # change, tolerance, target, device
    began: float  # s since the epoch
    t: float  # s, cameras' clock, of the pair that raised it
    text: str  # one sentence
    joints: tuple[int, ...] = ()  # counted from 1: the likeliest, then those not told apart from it
    error: float | None = None  # rad
    standard_uncertainty: float | None = None  # rad
    device: str | None = None
    ended: float | None = None  # s since the epoch; None while it stands; a change is an event
    revised: bool = False  # tells more of an alarm that was told before

    def fields(self) -> dict[str, Any]:
        """Units at the door: what a JSON line says of it."""
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
