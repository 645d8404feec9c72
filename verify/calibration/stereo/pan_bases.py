"""The turning bases: which turned, and how their readings scatter; boards in a hand.

A pan reading errs by so much from pair to pair. Where no base turns, a board that a hand moves
between the left picture and the right, or bends from pair to pair, errs alike; all are found as in
`scatter`. Both cameras see a bend alike, and a motion opposed.
"""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from verify.calibration.stereo import parameters as par
from verify.calibration.stereo.estimate import Estimate, readjust
from verify.calibration.stereo.gauge import BASE_FIXED, BASE_TURNING
from verify.calibration.stereo.prior import prior_rows
from verify.calibration.stereo.refusals import refuse_wrong_readings
from verify.calibration.stereo.scatter import ErrorScatter, adjust_with_scatter
from verify.core.records import SIDES, Array, Index

MIN_TURN = 1e-9  # rad: readings that differ by less are the same number
MIN_VISIBLE_TURN = np.deg2rad(0.1)  # a smaller range is a turn only if it shows an axis
MAX_AXIS_UNCERTAINTY = np.deg2rad(1.0)  # above it an axis is not determined
MAX_OFFSET_UNCERTAINTY = 0.02  # m, above it the axis's distance from the camera is not determined
MAX_HIDDEN_VARIANCE = 2.0  # of a parameter by a scatter that is not seen, over that without it
START_SIGMA = np.deg2rad(0.1)  # a poor base; the pictures give the scatter later
MIN_HAND_GAIN = 3.9  # log likelihood: 1 % of still, stiff boards by chance, in four kinds of error
START_HAND = 1e-3  # m, motion and bend of a board in a hand, likewise


def base_kinds(readings: Array) -> tuple[str, str]:
    """Classify each base as turning or fixed by its readings (b, 2), rad."""
    left, right = (BASE_TURNING if np.ptp(side) > MIN_TURN else BASE_FIXED for side in readings.T)
    return left, right


def start_precision(bases: tuple[str, str], noise: float) -> Array:
    """Weight of a pair's errors at first, (8,); `noise`: factor on the corners' uncertainty."""
    pan = [np.inf if base == BASE_FIXED else (noise / START_SIGMA) ** 2 for base in bases]
    return np.array([*pan, *np.full(par.N_ERRORS - len(pan), np.inf)])


def settle_bases(
    found: Estimate, corners: par.CornerStack, image_size: tuple[int, int]
) -> tuple[Estimate, ErrorScatter | None]:
    """Find how the readings scatter; bases whose readings but flicker are fixed.

    The image size is width and height, px. The scatter is None where no base turned.

    Raises:
        InputError: the bases stand too far off their readings.
    """
    if found.model.bases == (BASE_FIXED, BASE_FIXED):
        return found, None
    found, scatter = _with_scatter(found, corners)
    kinds = _visible_turns(found, corners.pan)
    if kinds == found.model.bases:
        return found, scatter
    model = replace(
        found.model,
        bases=kinds,
        precision=start_precision(kinds, found.noise),
        prior=prior_rows(found.state, kinds, image_size, found.variance),
    )
    state = replace(found.state, errors=np.zeros_like(found.state.errors))
    found = readjust(replace(found, state=state), corners, model)
    return (found, None) if kinds == (BASE_FIXED, BASE_FIXED) else _with_scatter(found, corners)


def _with_scatter(found: Estimate, corners: par.CornerStack) -> tuple[Estimate, ErrorScatter]:
    """Adjust with the readings' scatter where it is visible, or where few pairs hide what matters.

    Of many pairs a scatter that they do not show makes no variance much larger, and is left out.
    """
    turned = [i for i, base in enumerate(found.model.bases) if base != BASE_FIXED]
    found, (scatter,) = adjust_with_scatter(found, corners, [turned])
    if scatter.visible:  # before anything is adjusted as if they were right
        errors = found.state.errors[:, par.PAN_ERRORS]
        refuse_wrong_readings(scatter.deviation, corners.pan, errors)
        return found, scatter
    precision = found.model.precision.copy()
    precision[turned] = (found.noise / scatter.deviation) ** 2
    allowed = readjust(found, corners, replace(found.model, precision=precision))
    without, with_it = np.diag(found.covariance), np.diag(allowed.covariance)
    larger = with_it[without > 0] > MAX_HIDDEN_VARIANCE * without[without > 0]
    return (allowed if larger.any() else found), scatter


def boards_in_hand(
    found: Estimate, corners: par.CornerStack, image_size: tuple[int, int]
) -> Estimate | None:
    """Adjust with boards that moved between left and right, or bent from pair to pair.

    Whichever the pictures do not show stays 0; None where they show neither. The image size is
    width and height, px.
    """
    if found.model.bases != (BASE_FIXED, BASE_FIXED):
        return None
    motion, bend = (list(range(own.start, own.stop)) for own in (par.MOTION, par.BEND))
    precision = found.model.precision.copy()
    precision[motion + bend] = (found.noise / START_HAND) ** 2
    free = readjust(found, corners, replace(found.model, precision=precision))
    # the variance that is left without them would make what is known of lenses too strong
    prior = prior_rows(free.state, free.model.bases, image_size, free.variance)
    free = readjust(free, corners, replace(free.model, prior=prior))
    held, scatters = adjust_with_scatter(
        free, corners, [bend, *([axis] for axis in motion)], MIN_HAND_GAIN
    )
    return held if any(s.visible for s in scatters) else None


def with_doubt(found: Estimate, held: Estimate) -> Estimate:
    """State the uncertainty of an estimate that takes boards to stand still and not to bend.

    That of the estimate which allows for it, and how far the two are apart: its square is
    expected to be the difference of their covariances.

    Source: Hausman, Econometrica 46, 1978, lemma 2.1.
    """
    apart = par.parameter_difference(held.state, found.state)
    return replace(
        found,
        covariance=held.covariance + np.outer(apart, apart),
        design_effect=held.design_effect,
        design_effect_degrees=held.design_effect_degrees,
    )


def _visible_turns(found: Estimate, readings: Array) -> tuple[str, str]:
    """Kinds of the bases by their readings (b, 2), rad; fixed where these but flicker."""
    left, right = (
        BASE_FIXED if turn < MIN_VISIBLE_TURN and axis > MAX_AXIS_UNCERTAINTY else kind
        for kind, turn, (axis, _) in zip(
            found.model.bases, np.ptp(readings, axis=0), _open_axes(found), strict=True
        )
    )
    return left, right


def _open_axes(found: Estimate) -> list[tuple[float, float]]:
    """Standard uncertainties of each base's axis, rad, and of the camera's offset from it, m."""
    u = np.sqrt(np.maximum(np.diag(found.covariance), 0.0))
    sides = [u[par.camera_columns(index)] for index in range(len(SIDES))]
    return [(float(own[par.PAR_AXIS].max()), float(own[par.PAR_OFFSET].max())) for own in sides]


def base_sentences(
    found: Estimate, scatter: ErrorScatter | None, readings: Array, frames: Index
) -> Iterator[str]:
    """Describe what was found and chosen of each base, and the scatter of the pairs' readings."""
    sides = zip(SIDES, found.model.bases, readings.T, _open_axes(found), strict=True)
    for side, base, values, (axis, offset) in sides:
        degrees = np.rad2deg(np.ptp(values))
        if base == BASE_FIXED and np.ptp(values) <= MIN_TURN:
            yield (
                f"{side} base: not turned, so its axis is not determined: pan centre at the "
                "optical centre, axis +y, zero 0; the camera's orientation is its mount's."
            )
            continue
        if base == BASE_FIXED:
            yield (
                f"{side} base: turned too little to show its axis ({degrees:.2g}°); taken as +y "
                "through the optical centre."
            )
            continue
        yield (
            f"{side} base: turned over {degrees:.1f}°; its place along its axis is chosen (mount "
            "offset 0 along the axis), and so is the mount's turn about it (0, in the pan zero "
            "instead)."
        )
        open_parts = []
        if axis > MAX_AXIS_UNCERTAINTY:
            open_parts.append(f"its axis (± {2 * np.rad2deg(axis):.0f}°, k = 2)")
        if offset > MAX_OFFSET_UNCERTAINTY:
            open_parts.append(f"where that passes the camera (± {2e3 * offset:.0f} mm, k = 2)")
        if open_parts:
            yield (
                f"{side} base: turned too little to show {' and '.join(open_parts)}; a usual base "
                "is assumed, and the doubt is part of every uncertainty. Turn it further between "
                "pairs."
            )
    if scatter is not None and scatter.visible:
        off = np.rad2deg(found.state.errors[:, par.PAN_ERRORS])
        pair, base_index = divmod(int(np.abs(off).argmax()), len(SIDES))
        yield (
            f"pan readings: scatter by {np.rad2deg(scatter.deviation):.2g}°, which was allowed "
            f"for; farthest off is the {SIDES[base_index]} one of pair {frames[pair]}, "
            f"by {-off[pair, base_index]:+.2g}°."
        )
    elif scatter is not None:
        hidden = np.format_float_positional(
            np.rad2deg(scatter.deviation), 1, fractional=False, trim="-"
        )
        allowed = np.isfinite(found.model.precision[par.PAN_ERRORS]).any()
        yield (
            f"pan readings: no scatter is visible; {hidden}° may be there unseen and is stated as "
            f"their standard uncertainty{', which was allowed for' * bool(allowed)}."
        )
