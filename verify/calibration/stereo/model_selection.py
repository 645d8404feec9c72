"""Model selection: the lens coefficients that the corners support, and the board's bow.

A coefficient c with standard uncertainty u, of r residuals that count, is held

    k3            where c² <= u² ln(r)        Bayes' information criterion does not gain by it
    k2, p1, p2    where u > 0.5, 0.003, 0.003     less is known of it than of any lens
    fy - fx       where u > 0.005 fx              likewise

The others are not judged by their size: one that is small is small for that lens, and leaving it
out would move the principal point by more than its stated uncertainty. A held coefficient keeps a
standard uncertainty that propagates to all others: of k3 its own where chance seldom shows so much
(else 0), of the rest the limit.

A board that is not flat shifts the same corners in all images, which their scatter does not show:

    z(x, y) = h_0 x² + h_1 x y + h_2 y²     x, y over half the board's larger side

Parameters h (3), m, fitted beside the rig's 44 and the boards' own; kept where significant.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from verify.calibration.stereo import bundle
from verify.calibration.stereo.estimate import Estimate, invert, readjust
from verify.calibration.stereo.gauge import FOCAL_TIE, LENS_KEYS
from verify.calibration.stereo.parameters import (
    N_CAMERA_PARAMETERS,
    PAR_FOCAL,
    PAR_LENS,
    SIDES,
    CornerStack,
    camera_columns,
)
from verify.core.fiducials import Board
from verify.core.records import Array
from verify.core.statistics import chi2_isf

REFIT_ITERATIONS = 6  # after a coefficient was held: the state hardly moves
SIGMA_95 = 1.96  # standard uncertainties that chance exceeds once in twenty
P_FALSE_BOW = 1e-3  # that a flat board seems bowed
MAX_ROUNDS = 4  # of fitting the bow
TOL_MODE = 0.05  # of a mode's standard uncertainty
# What lenses and sensors of small cameras have, as standard uncertainties about 0.
TYPICAL_COEFFICIENTS = {"k2": 0.5, "p1": 0.003, "p2": 0.003}
TYPICAL_FOCAL_DIFFERENCE = 0.005  # of the focal length: difference of fx and fy


@dataclass(frozen=True, slots=True)
class DroppedCoefficient:
    """A coefficient that the pictures do not support and that is held at 0."""

    name: str  # left.k3; left.fy_px: the difference of the focal lengths
    value: float  # as found while it was free
    uncertainty: float
    remaining: float  # standard uncertainty that it keeps

    @property
    def sentence(self) -> str:
        """What was held and why."""
        side, _, key = self.name.partition(".")
        what, unit = (key, "") if key != FOCAL_TIE else ("fy - fx", " px")
        sentence = (
            f"{side} camera: {what} held at 0, as the pictures do not support it "
            f"({self.value:.2g} ± {self.uncertainty:.2g}{unit})"
        )
        if self.remaining:
            return f"{sentence}; ± {self.remaining:.2g}{unit} of it stays in the covariance."
        return f"{sentence}; the uncertainties hold for a lens without it."


def reduce_model(
    found: Estimate, corners: CornerStack
) -> tuple[Estimate, tuple[DroppedCoefficient, ...]]:
    """Hold the coefficients that the pictures do not support, one at a time, adjusting again."""
    dropped: list[DroppedCoefficient] = []
    while (weak := next(unsupported_coefficients(found), None)) is not None:
        dropped.append(weak)
        model = replace(found.model, held=(*found.model.held, weak.name))
        found = readjust(found, corners, model, REFIT_ITERATIONS)
    return found, tuple(dropped)


def unsupported_coefficients(found: Estimate) -> Iterator[DroppedCoefficient]:
    """List the free coefficients that the pictures do not support, the first to hold first."""
    # a pair whose corners err together counts for fewer
    price = float(np.log(max(2 * found.used.sum() / found.design_effect, math.e)))
    for side in SIDES:
        if f"{side}.k3" not in found.model.held:
            value, u = _coefficient(found, side, "k3")
            if value**2 <= price * u**2:
                remaining = u if abs(value) > SIGMA_95 * u else 0.0
                yield DroppedCoefficient(f"{side}.k3", value, u, remaining)
    for side, camera in zip(SIDES, found.state.cameras, strict=True):
        usual = {**TYPICAL_COEFFICIENTS, FOCAL_TIE: TYPICAL_FOCAL_DIFFERENCE * camera.matrix[0, 0]}
        for key, spread in usual.items():
            # k2 is held only where k3 is
            if f"{side}.{key}" in found.model.held or (
                key == "k2" and f"{side}.k3" not in found.model.held
            ):
                continue
            value, u = _coefficient(found, side, key)
            if u > spread:
                yield DroppedCoefficient(f"{side}.{key}", value, u, spread)


def _coefficient(found: Estimate, side: str, key: str) -> tuple[float, float]:
    """Value and standard uncertainty of a coefficient, or of fy less fx."""
    index = SIDES.index(side)
    camera = found.state.cameras[index]
    row = np.zeros(2 * N_CAMERA_PARAMETERS)
    own = row[camera_columns(index)]
    if key == FOCAL_TIE:
        own[PAR_FOCAL] = -1.0, 1.0
        value = camera.matrix[1, 1] - camera.matrix[0, 0]
    else:
        own[PAR_LENS.start + LENS_KEYS.index(key)] = 1.0
        value = camera.distortion[LENS_KEYS.index(key)]
    return float(value), float(np.sqrt(row @ found.covariance @ row))


def shortest_model() -> tuple[str, ...]:
    """All coefficients that may be held: the model to begin with."""
    return tuple(
        f"{side}.{key}" for side in SIDES for key in ("k3", *TYPICAL_COEFFICIENTS, FOCAL_TIE)
    )


def held_covariance(found: Estimate, dropped: Sequence[DroppedCoefficient]) -> Array:
    """Covariance (44, 44) of all parameters that the held coefficients' own uncertainty leaves."""
    full = found.system.information.sum(axis=0)
    forced = np.linalg.pinv(found.rows)[:, [found.held_row[d.name] for d in dropped]]
    pulled = found.basis.T @ full @ forced
    moved = forced - found.basis @ invert(found.information) @ pulled  # by a unit of each
    spread = moved * np.array([d.remaining for d in dropped])
    covariance: Array = spread @ spread.T
    return covariance


@dataclass(frozen=True, slots=True)
class BoardBow:
    """The bow of a board in its three modes x², x y and y²."""

    height: Array  # (3,), m, of each mode, into the board
    covariance: Array  # (3, 3), m²
    response: Array  # (44, 3), derivative of the rig's parameters by each height

    @property
    def sentence(self) -> str:
        """How large it is."""
        size = 1e3 * float(np.abs(self.height).max())
        return (
            f"the board is not flat: it bows by {size:.2f} mm between its middle and its rim, "
            "which was fitted along; a flat, stiff board is better."
        )


def fit_bow(
    found: Estimate, corners: CornerStack, board: Board
) -> tuple[Estimate, CornerStack, BoardBow | None]:
    """Fit the board's bow where it is significant; the corners returned are those of its shape."""
    modes = _modes(corners, board)
    fitted = _fit(found, corners, modes)
    z2 = float(fitted.height @ np.linalg.solve(fitted.covariance, fitted.height))
    if z2 <= chi2_isf(P_FALSE_BOW, 3):
        return found, corners, None
    height = np.asarray(np.linalg.lstsq(modes, corners.point[:, 2], rcond=None)[0], dtype=float)
    for _ in range(MAX_ROUNDS):
        height = height + fitted.height
        bent = corners.point.copy()
        bent[:, 2] = modes @ height
        corners = replace(corners, point=bent)
        found = readjust(found, corners)
        fitted = _fit(found, corners, modes)
        if np.all(np.abs(fitted.height) < TOL_MODE * np.sqrt(np.diag(fitted.covariance))):
            break
    return found, corners, replace(fitted, height=height)


def restate_bow(bow: BoardBow, found: Estimate, corners: CornerStack, board: Board) -> BoardBow:
    """Take a bow with covariance and response in the final model."""
    return replace(_fit(found, corners, _modes(corners, board)), height=bow.height)


def _modes(corners: CornerStack, board: Board) -> Array:
    xy = corners.point[:, :2] - board.points[:, :2].mean(axis=0)
    x, y = (xy / (np.ptp(board.points[:, :2], axis=0).max() / 2)).T
    return np.stack([x * x, x * y, y * y], axis=1)


def _fit(found: Estimate, corners: CornerStack, modes: Array) -> BoardBow:
    """Solve for one step of the modes with rig and boards eliminated."""
    by_rig, by_board = bundle.derivatives(found.state, corners)
    root = corners.root * found.used[:, None, None]
    normal_to = found.state.boards[corners.board][:, :3, 2]
    by_height = np.einsum("nij,nj->ni", by_board[:, :, :3], normal_to)
    shape = np.einsum("nij,njk->nik", root, by_height[:, :, None] * modes[:, None, :])
    rig, own = root @ by_rig @ found.basis, root @ by_board
    pixels = corners.observed - bundle.predict(found.state, corners)
    residual = np.einsum("nij,nj->ni", root, np.nan_to_num(pixels))
    count = found.basis.shape[1]
    full, pull = np.zeros((count + 3, count + 3)), np.zeros(count + 3)
    for b in range(len(found.state.boards)):
        mine = corners.board == b
        g = np.concatenate([rig[mine], shape[mine]], axis=2).reshape(-1, count + 3)
        a, r = own[mine].reshape(-1, own.shape[2]), residual[mine].ravel()
        across = a.T @ g
        inverse = found.system.own[b]
        full += g.T @ g - across.T @ inverse @ across
        pull += g.T @ r - across.T @ inverse @ found.system.own_gradient[b]
    both = invert(full)
    step = both @ pull
    covariance = found.noise**2 * both[count:, count:]
    moved = -found.basis @ invert(full[:count, :count]) @ full[:count, count:]
    return BoardBow(step[count:], covariance, moved)
