"""One pair of pictures with the LEDs marked: what the report shows of the raw evidence."""

import cv2
import numpy as np

from verify.marker import Marker
from verify.records import Image, Measurement, Sighting, StereoPair

WIDTH, HEIGHT = 720, 450  # px of one picture in the report
MARGIN = 0.35  # of the LEDs' extent, left around them
SMALLEST = 160  # px of the original: less shows nothing but squares
QUICK = (
    cv2.IMWRITE_PNG_FILTER,
    cv2.IMWRITE_PNG_FILTER_NONE,
    cv2.IMWRITE_PNG_STRATEGY,
    cv2.IMWRITE_PNG_STRATEGY_RLE,
)  # of a dark room: smaller too
RING = (80, 200, 80)  # BGR
TEXT = (60, 220, 255)


def draw_pair(pair: StereoPair, measurement: Measurement, marker: Marker) -> bytes:
    """Left and right picture about the LEDs, with a ring and a name at each; PNG bytes."""
    sides = [
        _marked(image, sighting, marker)
        for image, sighting in ((pair.left, measurement.left), (pair.right, measurement.right))
        if sighting is not None and len(sighting)
    ]
    encoded, png = cv2.imencode(".png", np.concatenate(sides, axis=1), QUICK)
    if not encoded:
        raise ValueError("OpenCV could not encode the preview as PNG")
    return png.tobytes()


def _marked(image: Image, sighting: Sighting, marker: Marker) -> Image:
    left, top, scale = _view(sighting, image.shape[1], image.shape[0])
    place = np.array([[scale, 0.0, -left * scale], [0.0, scale, -top * scale]])
    view = cv2.warpAffine(image, place, (WIDTH, HEIGHT), flags=cv2.INTER_AREA)
    view = view if view.ndim == 3 else cv2.cvtColor(view, cv2.COLOR_GRAY2BGR)
    for led, centre in zip(sighting.led, sighting.centre, strict=True):
        x, y = round((float(centre[0]) - left) * scale), round((float(centre[1]) - top) * scale)
        cv2.circle(view, (x, y), round(9 * scale), RING, 1, cv2.LINE_AA)
        name = "".join(c if c.isascii() and c.isprintable() else "?" for c in marker.names[led])
        there = (x + round(11 * scale), y - round(5 * scale))
        cv2.putText(view, name, there, cv2.FONT_HERSHEY_SIMPLEX, 0.6, TEXT, 1, cv2.LINE_AA)
    return np.asarray(view, dtype=np.uint8)


def _view(sighting: Sighting, width: int, height: int) -> tuple[float, float, float]:
    """Left and top edge (px) and magnification of the part of the picture that is shown."""
    low, high = sighting.centre.min(axis=0), sighting.centre.max(axis=0)
    extent = np.maximum((high - low) * (1 + 2 * MARGIN), SMALLEST)
    scale = float(min(WIDTH / extent[0], HEIGHT / extent[1]))
    scale = max(scale, WIDTH / width, HEIGHT / height)
    middle = (low + high) / 2
    left = np.clip(middle[0] - WIDTH / scale / 2, 0, width - WIDTH / scale)
    top = np.clip(middle[1] - HEIGHT / scale / 2, 0, height - HEIGHT / scale)
    return float(left), float(top), scale
