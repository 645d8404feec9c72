"""Uncertainty of a registration: its share of the rig's errors, and the joint errors it hides.

With H (rows, size) the derivatives of the predicted spots by base, LEDs, clock and skew, J
(rows, j) those by the readings, c (rows,) those by a stated rig parameter, all whitened by S⁻½:

    found by rig    d p / d r = -(H'H)⁻¹ H' c            covariance: D C_rig D' + own
    absorption      G = (H'H)⁺ H' J                      a joint that reads too high by d
                                                         moved what was fitted by -G d
    visible share   |J - H G| / |J|, joint by joint

What is not stated of the rig is taken as exact.
"""

import numpy as np

from robots.transforms import rigid_columns
from verify.calibration.registration.adjustment import AdjustedRegistration, block_diagonal
from verify.calibration.registration.model import BASE_COLUMNS
from verify.calibration.stereo.records import extend_covariance, state_covariance
from verify.core.fiducials import Marker
from verify.core.records import POSE_NAMES, Array
from verify.core.rig import Covariance, Rig
from verify.errors import InputError
from verify.measurement.sensitivities import AXES, camera_derivatives
from verify.measurement.systematics import CAMERA_KEYS

MIN_VISIBLE_SHARE = 1e-3  # smaller shares are rounding
BASE_NAMES = tuple(f"robot_base.{key}" for key in POSE_NAMES)


def led_names(names: tuple[str, ...]) -> tuple[str, ...]:
    """Name the LEDs' coordinates as rig.toml's covariance does."""
    return tuple(f"led.{name}.{axis}_mm" for name in names for axis in AXES)


def rig_covariance(
    rig: Rig, marker: Marker, adjusted: AdjustedRegistration, *, held_marker: bool
) -> Covariance:
    """The rig's covariance with base and LEDs added, correlations with the rig kept.

    LEDs that were held keep their own stated uncertainty.
    """
    fitted = [*BASE_NAMES, *led_names(marker.names)]
    free = adjusted.free[:-2]
    names = [n for n, is_free in zip(fitted, free, strict=True) if is_free]
    given = _retained_covariance(rig.covariance, names, marker)
    if held_marker:
        given = _add_marker(given, marker)
    own = adjusted.covariance[:-2, :-2][np.ix_(free, free)]
    own = own + _pan_covariance(rig, adjusted)[np.ix_(free, free)]
    if given is None:
        return state_covariance(names, own)
    by_given = np.stack(
        [_derivative_by(n, rig, marker, adjusted) for n in given.parameters], axis=1
    )
    return extend_covariance(given, names, by_given[free], own)


def _retained_covariance(
    given: Covariance | None, fitted: list[str], marker: Marker
) -> Covariance | None:
    """Drop from a covariance the parameters that are found anew and the LEDs of other markers."""
    if given is None:
        return None
    known = set(led_names(marker.names))
    keep = [
        i
        for i, n in enumerate(given.parameters)
        if n not in fitted and (not n.startswith("led.") or n in known)
    ]
    return given.take(keep) if keep else None


def _add_marker(given: Covariance | None, marker: Marker) -> Covariance | None:
    """Add what a marker states of its LEDs, unless the rig's covariance already has them."""
    names = led_names(marker.names)
    body, each = marker.body_standard_uncertainty, marker.led_standard_uncertainty
    if (body is None and each is None) or (given and set(names) & set(given.parameters)):
        return given
    motion = rigid_columns(marker.leds).reshape(-1, 6)
    spread = motion * (np.zeros(6) if body is None else body)
    full = spread @ spread.T + (each or 0.0) ** 2 * np.eye(len(names))
    if given is None:
        return state_covariance(names, full)
    return extend_covariance(given, names, np.zeros((len(names), len(given.parameters))), full)


def _derivative_by(name: str, rig: Rig, marker: Marker, adjusted: AdjustedRegistration) -> Array:
    """Derivative of base and LEDs by one stated parameter, (size - 2,), SI units or px."""
    names = [*BASE_NAMES, *led_names(marker.names)]
    if name in names:  # held: its own column of the design, and no derivative of itself
        return _response(adjusted, adjusted.predicted.design[:, :, names.index(name)])
    side, _, key = name.partition(".")
    if side not in ("left", "right") or not CAMERA_KEYS.match(key):
        return np.zeros(len(adjusted.free) - 2)
    return _response(adjusted, _camera_change(rig, side, key, adjusted))


def _camera_change(rig: Rig, side: str, key: str, adjusted: AdjustedRegistration) -> Array:
    """Derivative of the predicted spots by a parameter of one camera, (s, 2)."""
    spotted, predicted = adjusted.spotted, adjusted.predicted
    which = ("left", "right").index(side)
    camera = (rig.left, rig.right)[which]
    pixels = np.zeros_like(predicted.residual)
    for i in range(len(spotted)):
        mine = (spotted.pair == i) & (spotted.side == which)
        if mine.any():
            pixels[mine] = camera_derivatives(
                (key,), camera, float(spotted.pan[mine][0]), predicted.points_camera[mine],
                predicted.points_rig[mine], predicted.by_point[mine],
            )[0]  # fmt: skip
    return pixels


def _response(adjusted: AdjustedRegistration, pixels: Array) -> Array:
    """Change of base and LEDs, (size - 2,), by a change of the predicted spots (s, 2)."""
    return -(adjusted.gain @ pixels.reshape(-1))[:-2]


def _pan_covariance(rig: Rig, adjusted: AdjustedRegistration) -> Array:
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


def inherited_absorption(rig: Rig, *, base: bool, leds: Marker | None) -> Array | None:
    """Joint errors that held parts absorbed in their own registration, (6 + 3 n, j); None: none.

    Held are the base, and the LEDs of a marker if one is given.

    Raises:
        InputError: what is held was fitted through the encoders, and how is not known.
    """
    base = base and rig.base_source == "motion"
    kept = leds if leds is not None and leds.source == "motion" else None
    if not base and kept is None:
        return None
    strange = kept is not None and kept.registration != rig.registration
    if rig.absorption is None or strange:
        raise InputError(
            "--keep-base" if kept is None else "--keep-leds",
            "what is to be kept was fitted through the robot's encoders, and the rig does not "
            "hold that registration's absorption",
            "",
            "Give the rig.toml that the same registration wrote, or fit both again.",
        )
    if kept is None:
        return rig.absorption[:6]
    moved = rigid_columns(kept.leds).reshape(-1, 6) @ rig.absorption[6:]
    return np.concatenate([np.zeros_like(rig.absorption[:6]), moved])


def absorbed_offsets(adjusted: AdjustedRegistration, held: Array | None = None) -> Array:
    """Find G: how far each parameter makes up for a radian of joint offset, (size, j)."""
    design = np.where(adjusted.free, adjusted.rows.design, 0.0)
    before = np.zeros((adjusted.at.size, adjusted.rows.joints.shape[1]))
    if held is not None:
        before[: len(held)] = held
    left = adjusted.rows.joints - adjusted.rows.design @ before
    return before + adjusted.inverse @ (design.T @ left)


def absorption(adjusted: AdjustedRegistration, held: Array | None = None) -> Array:
    """Lay `absorbed_offsets` out as rig.toml holds it: base and LED-body motion a radian, (12, j).

    Rows 0 to 5: the base in rig axes (m, then rad), its turns about its own origin. Rows 6 to 11:
    the rigid part of the LEDs' change, in flange axes about the flange's origin. Rows of what was
    held are 0. A later session shows an offset's own effect less that of these motions.
    """
    taken = absorbed_offsets(adjusted, held)
    columns = rigid_columns(adjusted.at.leds).reshape(-1, 6)
    body = np.linalg.lstsq(columns, taken[6:-2], rcond=None)[0]
    return np.concatenate([taken[BASE_COLUMNS], body])


def visible_fractions(adjusted: AdjustedRegistration, held: Array | None = None) -> Array:
    """Share of a constant offset of each joint that stays visible in the pixels, (j,)."""
    taken, spotted = absorbed_offsets(adjusted, held), adjusted.spotted
    predicted, design = adjusted.predicted, adjusted.predicted.design
    left, whole = np.zeros(taken.shape[1]), np.zeros(taken.shape[1])
    for i in np.unique(spotted.pair[spotted.used]):  # of a rejected pair no spot is used
        mine = (spotted.pair == i) & spotted.used
        lower = np.linalg.cholesky(block_diagonal(spotted.covariance[mine]))
        joints = predicted.by_joint[mine].reshape(len(lower), -1)
        hidden = joints - design[mine].reshape(len(lower), -1) @ taken
        left += np.sum(np.linalg.solve(lower, hidden) ** 2, axis=0)
        whole += np.sum(np.linalg.solve(lower, joints) ** 2, axis=0)
    share = np.sqrt(np.divide(left, whole, out=np.zeros_like(left), where=whole > 0))
    return np.where(share < MIN_VISIBLE_SHARE, 0.0, np.minimum(share, 1.0))
