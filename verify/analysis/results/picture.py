"""The picture of one pair with its LEDs marked, for the report."""

import cv2
import numpy as np

from verify.core.fiducials import Marker
from verify.core.records import Image, Measurement, Sighting, StereoPair

WIDTH, HEIGHT = 720, 450  # px of one picture in the report
MARGIN = 0.35  # of the LEDs' extent, left around them
MIN_SIDE = 160  # px of the original: less shows nothing but squares
PNG_FLAGS = (
    cv2.IMWRITE_PNG_FILTER,
    cv2.IMWRITE_PNG_FILTER_NONE,
    cv2.IMWRITE_PNG_STRATEGY,
    cv2.IMWRITE_PNG_STRATEGY_RLE,
)  # of a dark room: smaller too
RING_COLOUR = (80, 200, 80)  # BGR
TEXT_COLOUR = (60, 220, 255)
MAX_NAME_LETTERS = 12  # of an LED, in a picture


def draw_pair(pair: StereoPair, measurement: Measurement, marker: Marker) -> bytes:
    """Left and right picture about the LEDs, with a ring and a name at each; PNG bytes."""
    sides = [
        _mark_leds(image, sighting, marker)
        for image, sighting in ((pair.left, measurement.left), (pair.right, measurement.right))
        if sighting is not None and len(sighting)
    ]
    return cv2.imencode(".png", np.concatenate(sides, axis=1), PNG_FLAGS)[1].tobytes()


def _mark_leds(image: Image, sighting: Sighting, marker: Marker) -> Image:
    left, top, width, height = _crop(sighting, image.shape[1], image.shape[0])
    part = image[top : top + height, left : left + width]
    scale = WIDTH / width
    way = cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR
    view = cv2.resize(part, (WIDTH, HEIGHT), interpolation=way)
    view = view if view.ndim == 3 else cv2.cvtColor(view, cv2.COLOR_GRAY2BGR)
    centres = (sighting.centre - [left, top] + 0.5) * [scale, HEIGHT / height] - 0.5
    for led, (x, y) in zip(sighting.led, np.rint(centres).astype(int).tolist(), strict=True):
        cv2.circle(view, (x, y), round(9 * scale), RING_COLOUR, 1, cv2.LINE_AA)
        # in the letters that OpenCV has; of a long one its ends, to cover no other
        name = "".join(c if c.isascii() and c.isprintable() else "?" for c in marker.names[led])
        name = name if len(name) <= MAX_NAME_LETTERS else f"{name[:5]}..{name[-5:]}"
        there = (x + round(11 * scale), y - round(5 * scale))
        cv2.putText(view, name, there, cv2.FONT_HERSHEY_SIMPLEX, 0.6, TEXT_COLOUR, 1, cv2.LINE_AA)
    return np.asarray(view, dtype=np.uint8)


def _crop(sighting: Sighting, width: int, height: int) -> tuple[int, int, int, int]:
    """Left and top edge, width and height (px) of the part of the picture that is shown."""
    low, high = sighting.centre.min(axis=0), sighting.centre.max(axis=0)
    extent = np.maximum((high - low) * (1 + 2 * MARGIN), MIN_SIDE)
    scale = float(min(WIDTH / extent[0], HEIGHT / extent[1]))
    scale = max(scale, WIDTH / width, HEIGHT / height)
    size = np.rint([WIDTH / scale, HEIGHT / scale])
    corner = np.clip(np.rint((low + high - size) / 2), 0, [width, height] - size)
    left, top, across, down = np.concatenate([corner, size]).astype(int).tolist()
    return left, top, across, down
