"""One pair of pictures with the LEDs marked: what the report shows of the raw evidence."""

import cv2
import numpy as np

from verify.marker import Marker
from verify.records import Image, Measurement, Sighting, StereoPair

WIDTH = 960  # px of one picture in the report
RING = (80, 200, 80)  # BGR
TEXT = (60, 220, 255)


def draw_pair(pair: StereoPair, measurement: Measurement, marker: Marker) -> bytes:
    """Left and right picture side by side with a ring and a name at each LED; PNG bytes."""
    sides = []
    for image, sighting in ((pair.left, measurement.left), (pair.right, measurement.right)):
        sides.append(_marked(image, sighting, marker))
    encoded, png = cv2.imencode(".png", np.concatenate(sides, axis=1))
    if not encoded:
        raise ValueError("OpenCV could not encode the preview as PNG")
    return png.tobytes()


def _marked(image: Image, sighting: Sighting | None, marker: Marker) -> Image:
    colour = image if image.ndim == 3 else cv2.cvtColor(image, cv2.COLOR_GRAY2BGR)
    scale = WIDTH / colour.shape[1]
    small = cv2.resize(colour, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    if sighting is None:
        return np.asarray(small, dtype=np.uint8)
    for led, centre in zip(sighting.led, sighting.centre, strict=True):
        x, y = (round(float(c) * scale) for c in centre)
        cv2.circle(small, (x, y), 11, RING, 1, cv2.LINE_AA)
        place = (x + 14, y - 8)
        name = "".join(c if c.isascii() and c.isprintable() else "?" for c in marker.names[led])
        cv2.putText(small, name, place, cv2.FONT_HERSHEY_SIMPLEX, 0.5, TEXT, 1, cv2.LINE_AA)
    return np.asarray(small, dtype=np.uint8)
