"""The LEDs on the flange."""

from dataclasses import dataclass

from verify.records import Array

COLOURS = ("white", "red", "green", "blue", "infrared")


@dataclass(frozen=True, slots=True)
class Marker:
    """Where the LEDs sit in the flange frame, and how well that is known."""

    names: tuple[str, ...]
    leds: Array  # (n, 3), m, flange frame
    colours: tuple[str | None, ...]
    led_diameter: float  # m
    source: str | None = None  # jig, measured, motion
    datum: str | None = None
    registration: str | None = None
    body_standard_uncertainty: Array | None = None  # (6,), m and rad, flange axes
    led_standard_uncertainty: float | None = None  # m, each LED in the body
    centre_shift_standard_uncertainty: float | None = None  # m

    def __len__(self) -> int:
        """Count the LEDs."""
        return len(self.names)
