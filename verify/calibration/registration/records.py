"""The result of a registration from motion, and the marker of LEDs that were found without one."""

from dataclasses import dataclass
from itertools import permutations
from pathlib import Path

import numpy as np

from verify.calibration.registration.led_tracks import MAX_LEDS
from verify.calibration.registration.model import SpotStack
from verify.core.fiducials import Marker
from verify.core.records import Array
from verify.core.rig import Rig
from verify.errors import InputError
from verify.measurement.triangulation import fit_rigid

MAX_MATCH_RMS = 4e-3  # m, rms: LEDs found to a millimetre or two, a marker measured with a ruler
LED_NAMES = "ABCDEF"


@dataclass(frozen=True, slots=True)
class MotionRegistration:
    """Base and LEDs from a motion, and the joint errors that this hides."""

    rig: Rig  # with robot base, absorption and the covariance of all that was found
    marker: Marker
    clock_offset: float  # s, added to the readings' time gives the cameras'
    clock_standard_uncertainty: float | None  # s; None: the motion does not show it, held
    skew: float  # s, by how much the right camera's stamps are early
    skew_standard_uncertainty: float | None  # s; None: the motion does not show it, held at 0
    visible_fractions: Array  # (j,), of a constant offset that was there already
    rms_px: float  # of the adjustment on all pairs
    fit_rms_px: float | None  # registered on every other part of the session …
    held_out_rms_px: float | None  # … and judged on the rest; None: too few pairs for that
    misfit: float  # chi² a degree of freedom, before uncertainties were enlarged by it
    pairs_used: int
    left_out: dict[int, str]  # by frame: why a pair does not count
    spots: SpotStack  # every one that was assigned to an LED
    residual: Array  # (s, 2), px, observed less predicted
    decisions: tuple[str, ...]
    warnings: tuple[str, ...]


def order_like_marker(marker: Marker, leds: Array, place: str | Path) -> Array:
    """Bring LEDs found (n, 3) into the marker's order, by distances; InputError: no order fits."""
    if len(marker) != len(leds) or not 3 <= len(leds) <= MAX_LEDS:
        found = f"has {len(marker)} LEDs"
        raise InputError(place, found, f"{len(leds)} move together in the pictures")
    best, misfit = leds, np.inf
    for order in permutations(range(len(leds))):
        turned = leds[list(order)]
        motion = fit_rigid(marker.leds, turned)
        off = marker.leds - turned @ motion[:3, :3].T - motion[:3, 3]
        size = float(np.sqrt(np.mean(np.sum(off**2, axis=1))))
        if size < misfit:
            best, misfit = turned, size
    if misfit > MAX_MATCH_RMS:
        found = f"puts the LEDs {misfit * 1e3:.1f} mm (rms) from where the pictures show them"
        expected = f"their mutual distances agree within {MAX_MATCH_RMS * 1e3:.0f} mm"
        raise InputError(place, found, expected, "Measure them again, or register without it.")
    return best


def build_marker(leds: Array, diameter: float, named: Marker | None) -> Marker:
    """The marker of a registration: positions found, names and colours given, or A, B, C."""
    if named is None:
        names, colours = tuple(LED_NAMES[: len(leds)]), (None,) * len(leds)
        return Marker(names, leds, colours, diameter, source="motion")
    return Marker(
        named.names, leds, named.colours, named.led_diameter, source="motion",
        centre_shift_standard_uncertainty=named.centre_shift_standard_uncertainty,
    )  # fmt: skip
