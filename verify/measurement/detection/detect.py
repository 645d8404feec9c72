"""Detect LED spots in an image: sub-pixel centres at the Cramér-Rao bound, with covariance.

Candidates are compact bright blobs (candidates.py). All else is one compiled call a picture
(kernels/spots.c), with the search for them in small windows: each is fitted by a profile between a
halo, a Gaussian and a blurred disc (kernels/fit.c, profile.py) under the image's own noise
(kernels/noise.c, residual_noise.c), and assessed by the residuals (kernels/quality.c). A hidden
sliver of the rim is corrected for (kernels/occlusion.c), and so is a background that bends
(kernels/background.c); what finer texture may do is measured beside the spots
(kernels/surroundings.c).
"""

import math

import numpy as np

from verify.core.records import Array, Image, Noise, Spots
from verify.errors import InputError
from verify.measurement.detection.candidates import (
    DIAMETER_RANGE,
    MAX_CANDIDATES,
    are_small,
    blob_search,
    find_candidates,
)
from verify.measurement.detection.kernels.entries import (
    Picture,
    SpotLimits,
    measure_in_windows,
    measure_spots,
)
from verify.measurement.detection.profile import profile_table

MAX_SPOTS = 24


def detect(
    image: Image,
    windows: Array | None = None,
    *,
    noise: Noise | None = None,
    lossy: bool = False,
) -> Spots:
    """Find the LED-like spots of an image and measure their centres.

    `image`: (h, w) grey or (h, w, 3) BGR, uint8. `windows` (m, 4), x0, y0, x1, y1, px: search there
    only. `noise` is of a pixel of one channel; None estimates it on this image. At most MAX_SPOTS
    are returned, the most LED-like ones. `lossy`: the image was a JPEG, whose errors are not white.

    Returns:
        Spots by falling peak. Those whose shape no single LED has are flagged `merged` and their
        covariance enlarged by the misfit; where a sliver of the rim may be hidden, the centre is
        the whole disc's, as it is where the background bends, and the covariance covers the
        correction; spots cut by the image's border are left out.

    Raises:
        InputError: not an 8-bit grey or BGR image, or windows of another shape.
    """
    check_image(image, windows)
    known = (0.0,) * 4 if noise is None else (noise.read**2, noise.gain, noise.black, 0.0)
    values, height, width = np.array(known), *image.shape[:2]
    picture = Picture(image, width, height, 1 if image.ndim == 2 else 3)
    limits, camera = SpotLimits(*DIAMETER_RANGE, MAX_SPOTS), (values, noise is None)
    if picture.channels == 1 and windows is not None and are_small(windows):
        search = blob_search(1), MAX_CANDIDATES
        fields = measure_in_windows(
            picture, windows, search, camera, profile_table(), limits, lossy
        )
    else:
        candidates, kind = find_candidates(image, windows), (windows is None, lossy)
        fields = measure_spots(picture, candidates, camera, profile_table(), limits, kind)
    if noise is None:
        read, gain, black, _ = values.tolist()
        noise = Noise(math.sqrt(read), gain, black)
    return Spots(*fields, noise)


def check_image(image: Image, windows: Array | None) -> None:
    """Refuse what is not a picture."""
    shape_right = image.ndim == 2 or (image.ndim == 3 and image.shape[2] == 3)
    if image.dtype != np.uint8 or not shape_right:
        raise InputError(
            "image",
            f"it holds {image.dtype} of shape {image.shape}",
            "an image is (height, width) or (height, width, 3), 8 bits",
            "Convert it, or set the camera to an 8-bit format.",
        )
    if windows is not None and (np.ndim(windows) != 2 or np.shape(windows)[1] != 4):
        raise InputError(
            "windows", f"their shape is {np.shape(windows)}", "one row x0, y0, x1, y1 a window"
        )
