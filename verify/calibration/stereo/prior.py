"""What is known beforehand of a lens and a turning base, where the pictures decide less.

Each is taken as normal about 0 with a standard uncertainty that no lens of small cameras and no
small base exceeds by much; with r the tangent of the half diagonal field:

    k2, k3       0.2 / r⁴, 0.2 / r⁶    each moves the picture's corner by a fifth of its radius
    p1, p2       0.003                 1
    fy - fx      0.005 fx              px
    pan axis     5°                    about the rig's x and z: how far it is from the rig's y axis
    mount        20°                   about the same: the camera's tilt on its base
    mount        50 mm                 how far the optical centre is from the axis

So no parameter is in or out: as far as the pictures leave k3 open, its doubt is in k1 and k2, and
as far as they leave open where an axis passes, its doubt is in every pose at another pan angle.
"""

from collections.abc import Iterator

import numpy as np

from verify.calibration.stereo import parameters as par
from verify.calibration.stereo.estimate import Estimate
from verify.calibration.stereo.gauge import BASE_FIXED
from verify.core.records import SIDES, Array

USUAL_CORNER_SHIFT = 0.2  # of the radius, by one coefficient
USUAL_TANGENTIAL = 0.003
USUAL_FOCAL_DIFFERENCE = 0.005  # of the focal length
# of a turning base's parameters, in rad and m, by column; of the others nothing is known
USUAL_BASE = np.full(par.N_CAMERA_PARAMETERS, np.inf)
USUAL_BASE[par.PAR_AXIS] = np.deg2rad([5.0, np.inf, 5.0])
USUAL_BASE[par.PAR_TURN] = np.deg2rad([20.0, np.inf, 20.0])
USUAL_BASE[par.PAR_OFFSET] = 0.05
OPEN_SHARE = 0.7  # of what is known beforehand: a coefficient known no better is called open
N_LENS = 5  # rows of a camera's lens
K2, P1, P2, K3 = (par.PAR_LENS.start + i for i in (1, 2, 3, 4))


def prior_rows(
    state: par.BundleState, bases: tuple[str, str], image_size: tuple[int, int], variance: float
) -> Array:
    """Rows (54, 47) whose products with `prior_values` cost their squares: ten of lenses first.

    The image size is width and height, px, the variance a factor on the inverse information of the
    corners as stated.
    """
    lens = np.zeros((len(SIDES), N_LENS, par.N_SHARED))
    base = np.zeros((len(SIDES), par.N_CAMERA_PARAMETERS, par.N_SHARED))
    for side, camera in enumerate(state.cameras):
        focal, columns = camera.matrix[0, 0], par.camera_columns(side)
        radius = float(np.hypot(*image_size)) / 2 / focal
        usual = (USUAL_CORNER_SHIFT / radius**4, USUAL_TANGENTIAL, USUAL_TANGENTIAL,
                 USUAL_CORNER_SHIFT / radius**6)  # fmt: skip
        own = lens[side, :, columns]
        own[range(4), [K2, P1, P2, K3]] = 1 / np.array(usual)
        own[4, par.PAR_FOCAL] = np.array([-1, 1]) / (USUAL_FOCAL_DIFFERENCE * focal)
        if bases[side] != BASE_FIXED:
            base[side, :, columns] = np.diag(1 / USUAL_BASE)
    rows = np.concatenate([lens.reshape(-1, par.N_SHARED), base.reshape(-1, par.N_SHARED)])
    return np.asarray(np.sqrt(variance) * rows)


def open_coefficients(found: Estimate) -> Iterator[str]:
    """Name the coefficients that the pictures hardly show, a sentence a camera."""
    if found.model.prior is None:
        return
    rows = found.model.prior[: len(SIDES) * N_LENS] / np.sqrt(found.variance)
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
