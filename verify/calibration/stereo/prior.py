"""What is known beforehand of a lens, where the pictures decide less.

Each is taken as normal about 0 with a standard uncertainty that no lens of small cameras exceeds by
much; with r the tangent of the half diagonal field:

    k2, k3       0.2 / r⁴, 0.2 / r⁶    each moves the picture's corner by a fifth of its radius
    p1, p2       0.003                 1
    fy - fx      0.005 fx              px

So no coefficient is in or out: as far as the pictures leave k3 open, its doubt is in k1 and k2.
"""

from collections.abc import Iterator

import numpy as np

from verify.calibration.stereo import parameters as par
from verify.calibration.stereo.estimate import Estimate
from verify.core.records import SIDES, Array

USUAL_CORNER_SHIFT = 0.2  # of the radius, by one coefficient
USUAL_TANGENTIAL = 0.003
USUAL_FOCAL_DIFFERENCE = 0.005  # of the focal length
OPEN_SHARE = 0.7  # of what is known beforehand: a coefficient known no better is called open
K2, P1, P2, K3 = (par.PAR_LENS.start + i for i in (1, 2, 3, 4))


def lens_rows(state: par.BundleState, image_size: tuple[int, int], variance: float) -> Array:
    """Rows (10, 47) whose products with `lens_values` cost their squares.

    The image size is width and height, px, the variance a factor on the inverse information of the
    corners as stated.
    """
    rows = np.zeros((len(SIDES), 5, par.N_SHARED))
    for side, camera in enumerate(state.cameras):
        focal = camera.matrix[0, 0]
        radius = float(np.hypot(*image_size)) / 2 / focal
        usual = (USUAL_CORNER_SHIFT / radius**4, USUAL_TANGENTIAL, USUAL_TANGENTIAL,
                 USUAL_CORNER_SHIFT / radius**6)  # fmt: skip
        own = rows[side, :, par.camera_columns(side)]
        own[range(4), [K2, P1, P2, K3]] = 1 / np.array(usual)
        own[4, par.PAR_FOCAL] = np.array([-1, 1]) / (USUAL_FOCAL_DIFFERENCE * focal)
    whole: Array = np.sqrt(variance) * rows.reshape(-1, par.N_SHARED)
    return whole


def open_coefficients(found: Estimate) -> Iterator[str]:
    """Name the coefficients that the pictures hardly show, a sentence a camera."""
    if found.model.lens is None:
        return
    rows = found.model.lens / np.sqrt(found.variance)
    known = np.sqrt(np.einsum("ki,ij,kj->k", rows, found.covariance, rows))
    names = [*(par.PARAMETER_KEYS[i] for i in (K2, P1, P2, K3)), "fy - fx"]
    for side, shares in zip(SIDES, known.reshape(len(SIDES), -1), strict=True):
        listed = ", ".join(n for n, share in zip(names, shares, strict=True) if share > OPEN_SHARE)
        if listed:
            yield (
                f"{side} camera: the pictures hardly show {listed}; values of usual lenses "
                "are assumed (about 0), and their uncertainty is part of every uncertainty. Let "
                "boards reach the picture's corners."
            )
