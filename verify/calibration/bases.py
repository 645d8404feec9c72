"""The turning bases: whether they turned, far enough to show their axes, and their readings."""

from dataclasses import replace

import numpy as np

from verify.calibration import bundle, pan
from verify.calibration.estimate import Estimate, estimate
from verify.calibration.gauge import CENTRED, FIXED, TURNING
from verify.calibration.parameters import AXIS, OFFSET, SIDES, WIDTH, Corners
from verify.records import Array

STILL = 1e-9  # rad: readings that differ by less are the same number
LOOSE_AXIS = np.deg2rad(3.0)  # an axis known worse than this is not known
LOOSE_OFFSET = 0.02  # m, likewise where it passes the camera
START = np.deg2rad(0.1)  # a poor base; the pictures say better later
ROUNDS = 6
SETTLED = 0.03  # share by which the scatter still changes: far below its own uncertainty


def turned(readings: Array) -> tuple[str, str]:
    """Tell which bases moved between pairs, from their readings (b, 2), rad."""
    left, right = (TURNING if np.ptp(side) > STILL else FIXED for side in readings.T)
    return left, right


def start_precision(bases: tuple[str, str], noise: float = 1.0) -> float:
    """How far a reading is trusted at first, 1/rad², against corners as stated."""
    return float("inf") if bases == (FIXED, FIXED) else (noise / START) ** 2


def settled(found: Estimate, corners: Corners) -> tuple[Estimate, pan.Scatter | None, list[str]]:
    """Find how far readings scatter, then hold what too small a turn leaves open, and say so."""
    found, scatter = with_scatter(found, corners)
    kinds, said = _shown(found)
    if kinds == found.model.bases:
        return found, scatter, said
    model = replace(found.model, bases=kinds, pan_precision=start_precision(kinds, found.noise))
    state = replace(found.state, pan_error=np.zeros_like(found.state.pan_error))
    state = bundle.adjust(state, corners, model, found.used.astype(float))
    return (*with_scatter(estimate(state, corners, model, found.used), corners), said)


def _shown(found: Estimate) -> tuple[tuple[str, str], list[str]]:
    """What the turns were large enough to show of each base."""
    kinds, said = list(found.model.bases), []
    u = np.sqrt(np.maximum(np.diag(found.covariance), 0.0))
    for index, side in enumerate(SIDES):
        own = u[index * WIDTH : (index + 1) * WIDTH]
        if kinds[index] == FIXED:
            continue
        axis, offset = float(own[AXIS].max()), float(own[OFFSET].max())
        if axis > LOOSE_AXIS:
            kinds[index] = FIXED
            said.append(
                f"{side} base: turned too little to show its axis (± {np.rad2deg(axis):.0f}°); "
                "taken as +y through the optical centre."
            )
        elif offset > LOOSE_OFFSET:
            kinds[index] = CENTRED
            said.append(
                f"{side} base: turned too little to show where its axis passes the camera "
                f"(± {1e3 * offset:.0f} mm); taken through the optical centre."
            )
    return (kinds[0], kinds[1]), said


def with_scatter(found: Estimate, corners: Corners) -> tuple[Estimate, pan.Scatter | None]:
    """Find how far readings scatter, and adjust with that; None where no base turned."""
    if not found.model.pan_errors:
        return found, None
    scatter = pan.scatter(found)
    for _ in range(ROUNDS):
        precision = (found.noise / scatter.deviation) ** 2 if scatter.visible else float("inf")
        model = replace(found.model, pan_precision=precision)
        state = found.state
        if not scatter.visible:
            state = replace(state, pan_error=np.zeros_like(state.pan_error))
        state = bundle.adjust(state, corners, model, found.used.astype(float))
        found = estimate(state, corners, model, found.used)
        if not scatter.visible:
            break
        before, scatter = scatter, pan.scatter(found)
        if abs(scatter.deviation - before.deviation) < SETTLED * before.deviation:
            break
    return found, scatter


def sentences(found: Estimate, scatter: pan.Scatter | None, readings: Array) -> list[str]:
    """Say what the bases showed."""
    said = []
    for side, base, values in zip(SIDES, found.model.bases, readings.T, strict=True):
        if base == FIXED and np.ptp(values) <= STILL:
            said.append(
                f"{side} base: not turned, so its axis cannot be seen: pan centre at the optical "
                "centre, axis +y, zero 0; the camera's orientation is its mount's."
            )
        elif base != FIXED:
            said.append(
                f"{side} base: turned over {np.rad2deg(np.ptp(values)):.1f}°; its place along its "
                "axis is chosen (mount offset 0 along the axis), and so is the mount's turn about "
                "it (0, in the pan zero instead)."
            )
    if scatter is not None and scatter.visible:
        said.append(
            f"pan readings: scatter by {np.rad2deg(scatter.deviation):.2g}°, which was allowed for."
        )
    elif scatter is not None:
        said.append(
            "pan readings: no scatter is visible, taken as exact; "
            f"{np.rad2deg(scatter.deviation):.1g}° could hide and is stated."
        )
    return said
