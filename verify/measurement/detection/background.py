"""Correct spots for the room that a bright camera shows behind them, and widen them by the rest.

Model: to a spot's plane, polynomials of second and third order are added,

    background = plane + c · b(u, w),   b = (u², u w, w², u³, u² w, u w², w³),   c ~ N(0, s²)

with (u, w) the pixel's place from the spot's centre over the patch's radius. With D the derivatives
by the spot's parameters, r the residuals and B those by c, all over the pixels' sigmas, A the
information on the parameters,

    S = B'B - B'D A⁻¹ D'B,   h = B'r - B'D A⁻¹ D'r,   c = (S + s⁻²)⁻¹ h,   centre += pull c

    symbol  meaning                                                                 unit
    s       curvature of the room over a patch, one for all spots of a picture      DN
    S, h    information and gradient of c, the spot's parameters following          DN^-2, DN^-1
    pull    -A⁻¹ D'B, the rows of x and y                                           px/DN

s is averaged over AMPLITUDES by their evidence, the sum of (h c - ln |1 + s² S|) / 2. What is finer
than that is measured: the correction and the fit together are linear in the pixels, so the same
weights on N_AROUND patches of the room beside each spot show how far it would move a centre. Their
median square over what noise and curvature explain, of all spots of a picture, adds the excess; a
spot's own mean square does where it is MAX_OWN times that.
Where the room is below black there is nothing of it.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from verify.core.kernels.linear_algebra import median
from verify.core.records import Array, Image
from verify.measurement.detection.candidates import (
    PATCH_REACH,
    Candidates,
    LocatedPatches,
    channel_weights,
)
from verify.measurement.detection.fit import SpotFit
from verify.measurement.detection.kernels import background as kernel

AMPLITUDES: Array = 0.1 * np.exp2(np.arange(9))  # DN, beside none at all
N_AROUND = 8  # patches of the room about each spot, two radii away
_ANGLES = 2 * np.pi / N_AROUND * np.arange(N_AROUND)
DIRECTIONS = np.column_stack([np.cos(_ANGLES), np.sin(_ANGLES)])
MIN_AROUND = 12  # responses, two a patch, of all spots of a picture: fewer show nothing
MAX_OWN = 3.0  # of the picture's: a spot's own surroundings move it more than chance
MEDIAN_CHI2 = 0.4549  # of chi² with one degree of freedom


def correct_for_background(
    image: Image,
    candidates: Candidates,
    batches: Sequence[tuple[LocatedPatches, SpotFit]],
    numbers: NDArray[np.intp],
) -> tuple[Array, Array]:
    """Correct spots of a picture for the room behind them.

    `batches` are of spots numbered on from one to the next, `numbers` (n,) those to correct, -1 for
    none; `candidates`: all lights, which are no part of the room.

    Returns:
        What to add to the centres, (n, 2) px, and to their covariances, (n, 2, 2) px².
    """
    shift, covariance = np.zeros((len(numbers), 2)), np.zeros((len(numbers), 2, 2))
    moved, explained = np.full((len(numbers), N_AROUND, 2), np.nan), np.zeros((len(numbers), 2))
    begin, parts, evidence = 0, [], np.zeros(len(AMPLITUDES))
    for cut, fit in batches:
        into = np.flatnonzero((numbers >= begin) & (numbers < begin + len(fit.parameters)))
        spots = numbers[into] - begin
        begin += len(fit.parameters)
        sums, its = kernel.sum_curvature(
            spots, fit.parameters, fit.information, cut.patches.pixels, fit.model, fit.whitened,
            AMPLITUDES,
        )  # fmt: skip
        evidence += its
        parts.append((cut, fit, into, spots, sums))
    highest = max(float(evidence.max()), 0.0)
    odds = np.exp(evidence - highest)
    share = odds / (odds.sum() + np.exp(-highest))  # of each amplitude; the rest is that of none
    lights = candidates.centre, PATCH_REACH * candidates.radius
    for cut, fit, into, spots, sums in parts:
        channels = channel_weights(cut.colour) if image.ndim == 3 else np.ones((len(cut.colour), 1))
        moments, explained[into], moved[into] = kernel.correct_centres(
            image.reshape(-1), image.shape[1::-1], channels, lights, DIRECTIONS, spots,
            (cut.origin, cut.patches.pixels, fit.model, fit.whitened), share, sums,
        )  # fmt: skip
        shift[into], covariance[into] = moments[:, :, 0], moments[:, :, 1:]
    ratio = (moved * moved / explained[:, None]).reshape(len(numbers), -1)
    seen = ratio >= 0.0
    count = seen.sum(axis=1)
    if count.sum() >= MIN_AROUND:
        pooled = max(median(ratio[seen]) / MEDIAN_CHI2, 1.0)
        own = np.where(seen, ratio, 0.0).sum(axis=1) / np.maximum(count, 1)
        excess = np.where(own > MAX_OWN * pooled, own, pooled) - 1.0
        covariance[:, [0, 1], [0, 1]] += excess[:, None] * explained
    return shift, covariance
