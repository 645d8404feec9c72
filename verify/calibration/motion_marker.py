"""LEDs found without a marker, under the names that a marker gives them."""

from itertools import permutations
from pathlib import Path

import numpy as np

from verify.calibration.tracks import MOST_LEDS
from verify.errors import InputError
from verify.marker import Marker
from verify.records import Array
from verify.triangulation import fit_rigid

WORST_MATCH = 4e-3  # m, rms: LEDs found to a millimetre or two, a marker measured with a ruler
NAMES = "ABCDEF"


def in_order_of(marker: Marker, leds: Array, place: str | Path) -> Array:
    """Bring LEDs found (n, 3) into the marker's order, by their mutual distances.

    Raises:
        InputError: no order fits.
    """
    if len(marker) != len(leds) or not 3 <= len(leds) <= MOST_LEDS:
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
    if misfit > WORST_MATCH:
        found = f"puts the LEDs {misfit * 1e3:.1f} mm (rms) from where the pictures show them"
        expected = f"their mutual distances agree within {WORST_MATCH * 1e3:.0f} mm"
        raise InputError(place, found, expected, "Measure them again, or register without it.")
    return best


def found_marker(leds: Array, diameter: float, named: Marker | None) -> Marker:
    """The marker of a registration: positions found, names and colours given, or A, B, C."""
    n = len(leds)
    return Marker(
        names=tuple(NAMES[:n]) if named is None else named.names,
        leds=leds,
        colours=(None,) * n if named is None else named.colours,
        led_diameter=diameter if named is None else named.led_diameter,
        source="motion",
        centre_shift_standard_uncertainty=None
        if named is None
        else named.centre_shift_standard_uncertainty,
    )
