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
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from verify.core.records import Array, Image
from verify.measurement.detection.candidates import (
    PATCH_REACH,
    Candidates,
    LocatedPatches,
    channel_weights,
)
from verify.measurement.detection.fit import SpotFit
from verify.measurement.detection.kernels.fit import MIN_INFORMATION
from verify.measurement.detection.kernels.pixels import (
    N_PARAMETERS,
    NEIGHBOUR_RADIUS,
    PAR_FLOOR,
    ROW_RADIUS2,
    ROW_RESIDUAL,
    ROW_USED,
    ROW_VARIANCE,
    ROW_VISIBLE,
)

AMPLITUDES = 0.1 * 2.0 ** np.arange(9)  # DN, beside none at all
N_TERMS = 7
MIN_VISIBLE = 0.5  # share of the noise about a spot that clipping must leave: above black
N_AROUND = 8  # patches of the room about each spot, two radii away
MIN_AROUND = 12  # responses, two a patch, of all spots of a picture: fewer show nothing
MAX_OWN = 3.0  # of the picture's: a spot's own surroundings move it more than chance
MEDIAN_CHI2 = 0.4549  # of chi² with one degree of freedom


@dataclass(frozen=True, slots=True)
class _Curvature:
    """What n spots of one batch show of the room; p pixels each."""

    rows: NDArray[np.intp]  # (n,), of the batch
    into: NDArray[np.intp]  # (n,), of the spots asked for
    information: Array  # (n, 7, 7), S
    gradient: Array  # (n, 7), h
    pull: Array  # (n, 2, 7)
    plain: Array  # (n, 2, p), centre a whitened residual, the room taken as a plane
    terms: Array  # (n, 7, p), B, the spot's parameters following
    weight: Array  # (n, p), one over sigma; 0 where a pixel does not count
    noise: Array  # (n,), variance of a pixel of the room, DN²


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
    begin, shown = 0, []
    for cut, fit in batches:
        into = np.flatnonzero((numbers >= begin) & (numbers < begin + len(fit.parameters)))
        rows = numbers[into] - begin
        above = _above_black(fit, rows)
        if above.any():
            shown.append((cut, _curvature(cut, fit, rows[above], into[above])))
        begin += len(fit.parameters)
    if not shown:
        return shift, covariance
    inverses = [_posteriors(curvature) for _, curvature in shown]
    share = _amplitude_shares([curvature for _, curvature in shown], inverses)
    ratios, expected = [], []
    for (cut, curvature), inverse in zip(shown, inverses, strict=True):
        its_shift, its_covariance, response = _correction(curvature, inverse, share)
        shift[curvature.into], covariance[curvature.into] = its_shift, its_covariance
        plain = np.square(curvature.plain * curvature.weight[:, None]).sum(axis=2)
        variance = plain * curvature.noise[:, None] + np.diagonal(its_covariance, axis1=1, axis2=2)
        moved = _room_responses(image, candidates, cut, curvature, response)
        ratios.append(moved**2 / variance[:, None])
        expected.append(variance)
    ratio = np.concatenate(ratios).ravel()
    ratio = ratio[np.isfinite(ratio)]
    if len(ratio) >= MIN_AROUND:
        pooled = max(float(np.median(ratio)) / MEDIAN_CHI2, 1.0)
        for (_, curvature), its, variance in zip(shown, ratios, expected, strict=True):
            seen = np.isfinite(its)
            own = np.where(seen, its, 0.0).sum(axis=(1, 2)) / np.maximum(seen.sum(axis=(1, 2)), 1)
            excess = np.where(own > MAX_OWN * pooled, own, pooled) - 1.0
            covariance[curvature.into[:, None], [0, 1], [0, 1]] += excess[:, None] * variance
    return shift, covariance


def _correction(curvature: _Curvature, inverse: Array, share: Array) -> tuple[Array, Array, Array]:
    """Average the correction of n spots over the amplitudes: shift, covariance, response.

    (n, 2) px; (n, 2, 2) px²; and (n, 2, p), px/DN, by which the corrected centre follows pixels.
    """
    reach = np.einsum("nib,knbc->knic", curvature.pull, inverse)  # (k, n, 2, 7), px a gradient
    moved = np.einsum("knic,nc->kni", reach, curvature.gradient)
    shift = np.einsum("k,kni->ni", share, moved)
    off = moved - shift
    spread = np.einsum("knic,njc->knij", reach, curvature.pull) + off[..., None] * off[..., None, :]
    none = (1.0 - share.sum()) * shift[:, :, None] * shift[:, None]
    response = curvature.plain + np.tensordot(share, reach, 1) @ curvature.terms
    response *= curvature.weight[:, None]
    return shift, np.einsum("k,knij->nij", share, spread) + none, response


def _surroundings(fit: SpotFit, rows: NDArray[np.intp]) -> NDArray[np.bool_]:
    """Which pixels of the spots `rows` (n,) show the room alone, (n, p)."""
    far = fit.model[rows, ROW_RADIUS2] > NEIGHBOUR_RADIUS**2
    return np.asarray(far & (fit.model[rows, ROW_USED] > 0), dtype=np.bool_)


def _above_black(fit: SpotFit, rows: NDArray[np.intp]) -> NDArray[np.bool_]:
    """Whether the room about each of the spots `rows` (n,) is above black, (n,)."""
    about = _surroundings(fit, rows)
    visible = (fit.model[rows, ROW_VISIBLE] * about).sum(axis=1)
    return np.asarray(visible > MIN_VISIBLE * np.maximum(about.sum(axis=1), 1), dtype=np.bool_)


def _curvature(
    cut: LocatedPatches, fit: SpotFit, rows: NDArray[np.intp], into: NDArray[np.intp]
) -> _Curvature:
    """Say what the spots `rows` (n,) of a batch show of curvature of the room."""
    pixels, model, whitened = cut.patches.pixels[rows], fit.model[rows], fit.whitened[rows]
    place = pixels[:, 2:] - fit.parameters[rows, :2, None]
    place /= np.linalg.norm(pixels[:, 2:], axis=1).max()
    u, w = place[:, 0], place[:, 1]
    square = (u * u, u * w, w * w)
    terms = np.stack([*square, square[0] * u, square[0] * w, square[2] * u, square[2] * w], axis=1)
    curved = whitened[:, None, PAR_FLOOR] * terms
    by_parameter, residual = whitened[:, :N_PARAMETERS], whitened[:, ROW_RESIDUAL]
    inverse = np.linalg.inv(fit.information[rows] + MIN_INFORMATION * np.eye(N_PARAMETERS))
    pull = inverse @ (by_parameter @ np.swapaxes(curved, 1, 2))  # (n, 10, 7)
    following = curved - np.swapaxes(pull, 1, 2) @ by_parameter
    about = _surroundings(fit, rows)
    weight: Array = np.sqrt(model[:, ROW_USED] / model[:, ROW_VARIANCE])
    return _Curvature(
        rows, into, following @ np.swapaxes(curved, 1, 2),
        (following @ residual[..., None])[..., 0],
        -pull[:, :2], inverse[:, :2] @ by_parameter, following, weight,
        (model[:, ROW_VARIANCE] * about).sum(axis=1) / about.sum(axis=1),
    )  # fmt: skip


def _posteriors(curvature: _Curvature) -> Array:
    """Covariances of c, (k, n, 7, 7) DN², at each of k amplitudes."""
    prior = np.eye(N_TERMS) / np.square(AMPLITUDES)[:, None, None, None]
    inverse: Array = np.linalg.inv(curvature.information + prior)
    return inverse


def _amplitude_shares(curvatures: Sequence[_Curvature], inverses: Sequence[Array]) -> Array:
    """Posterior probability of each amplitude, (k,); what is missing to 1 is that of none."""
    evidence = np.zeros(len(AMPLITUDES))
    for one, inverse in zip(curvatures, inverses, strict=True):
        mean = (inverse @ one.gradient[..., None])[..., 0]
        gain = (mean * one.gradient).sum(axis=(1, 2))
        volume = np.linalg.slogdet(inverse)[1] - 2 * N_TERMS * np.log(AMPLITUDES)[:, None]
        evidence += (gain + volume.sum(axis=1)) / 2
    highest = max(float(evidence.max()), 0.0)
    odds = np.exp(evidence - highest)
    share: Array = odds / (odds.sum() + np.exp(-highest))
    return share


def _room_responses(
    image: Image,
    candidates: Candidates,
    cut: LocatedPatches,
    curvature: _Curvature,
    response: Array,
) -> Array:
    """Apply the centres' weights, `response` (n, 2, p) px/DN, to the room beside n spots.

    Gives what a centre would move by, (n, N_AROUND, 2) px; nan where a patch is not all of the
    room: beyond the picture, or reached by a light.
    """
    place = cut.patches.pixels[curvature.rows, 2:].astype(np.intp)  # (n, 2, p), px
    radius = int(np.abs(place).max())
    angle = 2 * np.pi / N_AROUND * np.arange(N_AROUND)
    step = np.rint(2 * radius * np.column_stack([np.cos(angle), np.sin(angle)])).astype(np.intp)
    middle = cut.origin[curvature.rows][:, None] + step  # (n, w, 2)
    size = np.array(image.shape[1::-1])
    clear = np.all((middle >= radius) & (middle < size - radius), axis=2)
    apart = np.linalg.norm(middle[:, :, None] - candidates.centre, axis=3)
    clear &= np.all(apart > radius + PATCH_REACH * candidates.radius, axis=2)
    # pixels numbered row by row: those of a patch beyond the picture are others, and left out
    number = (middle @ [1, size[0]])[..., None] + (place[:, 0] + size[0] * place[:, 1])[:, None]
    pixels = image.reshape(size.prod(), -1)
    values = pixels.take(number, axis=0, mode="clip").astype(float)
    weights = channel_weights(cut.colour[curvature.rows]) if image.ndim == 3 else np.ones((1, 1))
    values = (values @ weights[:, None, :, None])[..., 0]
    values -= values.mean(axis=2, keepdims=True)
    moved = values @ np.swapaxes(response, 1, 2)
    return np.where(clear[..., None], moved, np.nan)
