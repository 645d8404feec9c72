"""Pictures for the page: small, as JPEG, encoded once for all who look."""

import cv2

from verify.records import Image

WIDTH = 640  # px of a picture on the page
QUALITY = 72  # of JPEG


def small_jpeg(image: Image) -> bytes:
    """Scale a picture (h, w) or (h, w, 3) down, if it is large, and encode it."""
    scale = min(WIDTH / image.shape[1], 1.0)
    small = cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    encoded, jpeg = cv2.imencode(".jpg", small, [cv2.IMWRITE_JPEG_QUALITY, QUALITY])
    if not encoded:
        raise ValueError("OpenCV could not encode a picture for the page as JPEG")
    return jpeg.tobytes()
