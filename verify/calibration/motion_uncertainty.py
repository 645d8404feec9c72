"""What a registration inherits from the rig it was made with: derivatives by the rig's parameters.

What is not stated of the rig is taken as exact, here as everywhere.
"""

from dataclasses import replace

import numpy as np

from verify.calibration.covariance import extend, stated
from verify.calibration.motion_adjust import Adjusted
from verify.marker import Marker
from verify.records import Array
from verify.rig import Covariance, Rig
from verify.spot_derivatives import AXES, camera_pixels
from verify.systematics import BODY, CAMERA_KEYS

BASE_NAMES = tuple(f"robot_base.{key}" for key in BODY)


def led_names(names: tuple[str, ...]) -> tuple[str, ...]:
    """Name the LEDs' coordinates as rig.toml's covariance does."""
    return tuple(f"led.{name}.{axis}_mm" for name in names for axis in AXES)


def with_inherited(
    rig: Rig, marker: Marker, adjusted: Adjusted, *, held_marker: bool
) -> Covariance:
    """The rig's covariance with base and LEDs added, correlations with the rig kept.

    Args:
        rig: the rig that was registered in, with what it states of itself.
        marker: the LEDs under their names; where they were held, with their own uncertainty.
        adjusted: what was found.
        held_marker: the LEDs were held, so their stated uncertainty is inherited too.
    """
    fitted = [*BASE_NAMES, *led_names(marker.names)]
    free = adjusted.free[:-2]
    names = [n for n, is_free in zip(fitted, free, strict=True) if is_free]
    given = _kept(rig.covariance, names, marker)
    if held_marker:
        given = _with_marker(given, marker)
    own = adjusted.covariance[:-2, :-2][np.ix_(free, free)]
    own = own + _by_pan(rig, adjusted)[np.ix_(free, free)]
    if given is None:
        return stated(names, own)
    by_given = np.stack([_by(n, rig, marker, adjusted) for n in given.parameters], axis=1)
    return extend(given, names, by_given[free], own)


def _kept(given: Covariance | None, fitted: list[str], marker: Marker) -> Covariance | None:
    """What stays of a covariance when parameters are found anew and others' LEDs are gone."""
    if given is None:
        return None
    known = set(led_names(marker.names))
    keep = [
        i
        for i, n in enumerate(given.parameters)
        if n not in fitted and (not n.startswith("led.") or n in known)
    ]
    if not keep:
        return None
    return replace(
        given,
        parameters=tuple(given.parameters[i] for i in keep),
        standard_uncertainty=given.standard_uncertainty[keep],
        correlation=given.correlation[np.ix_(keep, keep)],
    )


def _with_marker(given: Covariance | None, marker: Marker) -> Covariance | None:
    """Add what a marker states of its LEDs, unless the rig's covariance already has them."""
    names = led_names(marker.names)
    body, each = marker.body_standard_uncertainty, marker.led_standard_uncertainty
    if (body is None and each is None) or (given and set(names) & set(given.parameters)):
        return given
    motion = rigid_columns(marker.leds)
    spread = motion * (np.zeros(6) if body is None else body)
    full = spread @ spread.T + (each or 0.0) ** 2 * np.eye(len(names))
    if given is None:
        return stated(names, full)
    return extend(given, names, np.zeros((len(names), len(given.parameters))), full)


def rigid_columns(leds: Array) -> Array:
    """What a motion of the LED body (flange axes, m and rad) does to its LEDs, (3 n, 6)."""
    turn = np.cross(np.eye(3)[None], leds[:, None]).transpose(0, 2, 1)
    columns = np.concatenate([np.tile(np.eye(3), (len(leds), 1, 1)), turn], axis=2)
    return columns.reshape(-1, 6)


def _by(name: str, rig: Rig, marker: Marker, adjusted: Adjusted) -> Array:
    """Derivative of base and LEDs by one stated parameter, (size - 2,), SI units or px."""
    names = [*BASE_NAMES, *led_names(marker.names)]
    if name in names:  # held: its own column of the design, and no derivative of itself
        return _response(adjusted, adjusted.predicted.design[:, :, names.index(name)])
    side, _, key = name.partition(".")
    if side not in ("left", "right") or not CAMERA_KEYS.match(key):
        return np.zeros(len(adjusted.free) - 2)
    return _response(adjusted, _camera_change(rig, side, key, adjusted))


def _camera_change(rig: Rig, side: str, key: str, adjusted: Adjusted) -> Array:
    """How the predicted spots change with a parameter of one camera, (s, 2)."""
    spotted, seen = adjusted.spotted, adjusted.predicted
    which = ("left", "right").index(side)
    camera = (rig.left, rig.right)[which]
    pixels = np.zeros_like(seen.residual)
    for i, sightings in enumerate(spotted.sightings):
        mine = (spotted.pair == i) & (spotted.side == which)
        if mine.any():
            pixels[mine] = camera_pixels(
                (key,), camera, sightings[which].pan, seen.points_camera[mine],
                seen.points_rig[mine], seen.by_point[mine],
            )[0]  # fmt: skip
    return pixels


def _response(adjusted: Adjusted, pixels: Array) -> Array:
    """How base and LEDs answer to a change of the predicted spots (s, 2), (size - 2,)."""
    change: Array = -(adjusted.gain @ pixels.reshape(-1))[:-2]
    return change


def _by_pan(rig: Rig, adjusted: Adjusted) -> Array:
    """Covariance from the uncertainty of the pan readings; pairs of one reading share its error."""
    size = len(adjusted.free) - 2
    total = np.zeros((size, size))
    for which, (side, camera) in enumerate((("left", rig.left), ("right", rig.right))):
        if not camera.pan_standard_uncertainty:
            continue
        change = _camera_change(rig, side, "pan_zero_deg", adjusted)
        mine = adjusted.spotted.side == which
        for reading in np.unique(adjusted.spotted.pan[mine]):
            alike = mine & (adjusted.spotted.pan == reading)
            moved = _response(adjusted, np.where(alike[:, None], change, 0.0))
            total += camera.pan_standard_uncertainty**2 * np.outer(moved, moved)
    return total
