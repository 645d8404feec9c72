"""Sentences for repeated poses: why there are none, and how a test differs from the standard's."""

from collections.abc import Callable
from typing import Any

from reports.formatting import DASH, count, joined, number, quantity

REASONS = {
    "no_holds": (
        "No repeated poses or paths: the arm was not seen standing still, or its readings never "
        "stand."
    ),
    "no_repeats": (
        "No repeated poses or paths: nothing was visited five times or more, so nothing can be "
        "said of repeatability."
    ),
    "poses_not_determined": (
        "No repeated poses or paths: the pose was not wholly determined in every pair."
    ),
}

ALWAYS = {
    "commanded": (
        "Commanded poses are not known: the mean of what the encoders read stands for them, so an "
        "error of the controller that its encoders see is not part of AP or AT."
    ),
    "registration": (
        "Base or LEDs were registered through the robot's own encoders: AP and AT show only what "
        "that registration could not take up."
    ),
    "load": "The load is not known; 100 % of the rated load is asked for.",
    "speed": (
        "The speed set at the controller is not known; 100 % of the rated speed is asked for."
    ),
    "warm_up": "It is not known whether the arm was warm; warming up is asked for.",
    "settling": (
        "A visit counts from when the encoders stand; the standard waits until the arm has settled."
    ),
    "cube": (
        "It is not known whether the poses lie in the test cube of the standard, and in which of "
        "its planes."
    ),
    "flange": "Positions are of the flange's centre, not of a point at the tool's offset.",
    "point": "Positions are of the point that the instrument measured.",
    "temperature_unknown": "The temperature is not stated; 20 °C ± 2 °C is asked for.",
}


def deviation(entry: dict[str, Any]) -> str:
    """Say one condition that differs from the standard's."""
    kind = str(entry.get("kind"))
    if kind in ALWAYS:
        return ALWAYS[kind]
    return WORDED[kind](entry) if kind in WORDED else kind.replace("_", " ")


def _names(entry: dict[str, Any]) -> str:
    return joined([str(pose) for pose in entry.get("poses") or [DASH]])


WORDED: dict[str, Callable[[dict[str, Any]], str]] = {
    "cycles": lambda e: (
        f"{count(e.get('found'))} visits of the pose seen least; {count(e.get('standard'))} are "
        "asked for."
    ),
    "passages": lambda e: (
        f"{count(e.get('found'))} passages of the path seen least; {count(e.get('standard'))} are "
        "asked for."
    ),
    "poses": lambda e: (
        f"Number of poses: {count(e.get('found'))}; {count(e.get('standard'))} are asked for."
    ),
    "plane": lambda e: (
        f"The five poses lie up to {number(e.get('off_plane_mm'), 1)} mm off one plane; a diagonal "
        "plane of a cube is asked for."
    ),
    "approach": lambda e: (
        "Approached from several poses, where one way is asked for, so that RP holds their "
        f"difference: {_names(e)}."
    ),
    "drift": lambda e: (
        f"Drift was followed for {quantity(_hours(e.get('found_s')), 'h')}; 8 h are asked for."
    ),
    "uncertainty": lambda e: (
        "The expanded uncertainty exceeds a quarter of AP, where a quarter is the most that the "
        f"standard allows: {_names(e)}. The smallest AP that could be stated for all poses is "
        f"{quantity(e.get('smallest_mm'), 'mm')}."
    ),
    "temperature": lambda e: (
        f"The temperature was {number(e.get('found_c'), 1)} °C; 20 °C ± 2 °C is asked for."
    ),
}


def _hours(seconds: Any) -> float | None:
    return float(seconds) / 3600 if isinstance(seconds, int | float) else None
