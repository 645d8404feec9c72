"""The turning bases: which turned, far enough to determine their axes; boards in a hand.

A pan reading errs by so much from pair to pair. Where no base turns, a board that a hand moves
between the left picture and the right, or bends from pair to pair, errs alike; all are found as in
`scatter`. Both cameras see a bend alike, and a motion opposed.
"""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from verify.calibration.stereo import parameters as par
from verify.calibration.stereo.estimate import Estimate, readjust
from verify.calibration.stereo.gauge import BASE_CENTRED, BASE_FIXED, BASE_TURNING
from verify.calibration.stereo.prior import lens_rows
from verify.calibration.stereo.refusals import refuse_wrong_readings
from verify.calibration.stereo.scatter import ErrorScatter, adjust_with_scatter
from verify.core.records import SIDES, Array, Index

MIN_TURN = 1e-9  # rad: readings that differ by less are the same number
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
    found: Estimate, corners: par.CornerStack
) -> tuple[Estimate, ErrorScatter | None, list[str]]:
    """Find how the readings scatter, then hold what the bases' turns do not determine.

    Returns the scatter, None where no base turned, and a sentence for each base that is held.

    Raises:
        InputError: the bases stand too far off their readings.
    """
    if found.model.bases == (BASE_FIXED, BASE_FIXED):
        return found, None, []
    found, scatter = _with_scatter(found, corners)
    kinds, sentences = _determined_bases(found)
    if kinds == found.model.bases:
        return found, scatter, sentences
    model = replace(found.model, bases=kinds, precision=start_precision(kinds, found.noise))
    state = replace(found.state, errors=np.zeros_like(found.state.errors))
    found = readjust(replace(found, state=state), corners, model)
    if kinds == (BASE_FIXED, BASE_FIXED):
        return found, None, sentences
    return *_with_scatter(found, corners), sentences


def _with_scatter(found: Estimate, corners: par.CornerStack) -> tuple[Estimate, ErrorScatter]:
    """Adjust with the readings' scatter where it is visible, or where few pairs hide what matters.

    Of many pairs a scatter that they do not show makes no variance much larger, and is left out.
    """
    turned = _turned(found.model.bases)
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


def _turned(bases: tuple[str, str]) -> list[int]:
    return [i for i, base in enumerate(bases) if base != BASE_FIXED]


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
    lens = lens_rows(free.state, image_size, free.variance)
    free = readjust(free, corners, replace(free.model, lens=lens))
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


def _determined_bases(found: Estimate) -> tuple[tuple[str, str], list[str]]:
    """Choose the kind of each base by what its turn determines, and explain each choice."""
    kinds, sentences = list(found.model.bases), []
    u = np.sqrt(np.maximum(np.diag(found.covariance), 0.0))
    for index, side in enumerate(SIDES):
        own = u[par.camera_columns(index)]
        if kinds[index] == BASE_FIXED:
            continue
        axis, offset = float(own[par.PAR_AXIS].max()), float(own[par.PAR_OFFSET].max())
        if axis > MAX_AXIS_UNCERTAINTY:
            kinds[index] = BASE_FIXED
            sentences.append(
                f"{side} base: turned too little to show its axis "
                f"(± {2 * np.rad2deg(axis):.0f}°, k = 2); taken as +y through the optical centre."
            )
        elif offset > MAX_OFFSET_UNCERTAINTY:
            kinds[index] = BASE_CENTRED
            sentences.append(
                f"{side} base: turned too little to show where its axis passes the camera "
                f"(± {2e3 * offset:.0f} mm, k = 2); taken through the optical centre."
            )
    return (kinds[0], kinds[1]), sentences


def base_sentences(
    found: Estimate, scatter: ErrorScatter | None, readings: Array, frames: Index
) -> Iterator[str]:
    """Describe what was found and chosen of each base, and the scatter of the pairs' readings."""
    for side, base, values in zip(SIDES, found.model.bases, readings.T, strict=True):
        if base == BASE_FIXED and np.ptp(values) <= MIN_TURN:
            yield (
                f"{side} base: not turned, so its axis is not determined: pan centre at the "
                "optical centre, axis +y, zero 0; the camera's orientation is its mount's."
            )
        elif base != BASE_FIXED:
            yield (
                f"{side} base: turned over {np.rad2deg(np.ptp(values)):.1f}°; its place along its "
                "axis is chosen (mount offset 0 along the axis), and so is the mount's turn about "
                "it (0, in the pan zero instead)."
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
