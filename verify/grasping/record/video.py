"""Write the film of a grasp: both pictures, the searched windows, the target, and the state."""

from fractions import Fraction
from pathlib import Path

import av
import cv2
import numpy as np

from verify.core.records import Image
from verify.grasping.control.aim import LoopCycle

WIDTH, HEIGHT, STRIP_HEIGHT = 640, 360, 40  # px: of each picture, and of the line of text below
WHITE, OUTLINE_COLOUR, WINDOW_COLOUR = (255, 255, 255), (60, 230, 255), (200, 200, 200)  # BGR
STATE_COLOURS = {"lifted": (90, 200, 90), "fault": (60, 60, 230), "missed": (60, 140, 240)}
CODECS = ("libx264", "mpeg4")  # the first that this build of FFmpeg has
ENCODER_OPTIONS = {"libx264": {"crf": "20", "preset": "veryfast"}, "mpeg4": {"qscale": "3"}}


class Mp4Writer:
    """An MP4 file that grows picture by picture."""

    def __init__(self, path: Path, rate: float) -> None:
        self.codec = next(name for name in CODECS if name in av.codecs_available)
        self._container = av.open(str(path), "w")
        exact = max(Fraction(rate).limit_denominator(1000), Fraction(1, 1000))  # MPEG-4's limits
        stream = self._container.add_stream(self.codec, exact, ENCODER_OPTIONS[self.codec])
        assert isinstance(stream, av.VideoStream)
        self._stream = stream
        stream.width, stream.height = 2 * WIDTH, HEIGHT + STRIP_HEIGHT
        stream.pix_fmt = "yuv420p"
        self._last = np.zeros((HEIGHT, 2 * WIDTH, 3), np.uint8)

    def add(self, cycle: LoopCycle) -> Image:
        """Append a cycle, with the last pictures if none are new; returns it as filmed, BGR."""
        if cycle.pair is not None:
            self._last = np.hstack([_annotated_picture(cycle, 0), _annotated_picture(cycle, 1)])
        picture = np.vstack([self._last, _text_strip(cycle)])
        frame = av.VideoFrame.from_ndarray(picture, format="bgr24")
        for packet in self._stream.encode(frame):
            self._container.mux(packet)
        return picture

    def close(self) -> None:
        """Write what is under way, and the index by which players find their way."""
        for packet in self._stream.encode():
            self._container.mux(packet)
        self._container.close()


def _annotated_picture(cycle: LoopCycle, side: int) -> Image:
    """One camera's picture with CAMSHIFT's window and ellipse."""
    assert cycle.pair is not None
    image = (cycle.pair.left, cycle.pair.right)[side]
    scale = WIDTH / image.shape[1]
    small = cv2.resize(image, (WIDTH, HEIGHT), interpolation=cv2.INTER_AREA)
    picture = np.asarray(small, dtype=np.uint8)
    if cycle.observation is not None:
        window = cycle.observation.windows[side]
        if window is not None:
            x, y, w, h = (round(scale * v) for v in window)
            cv2.rectangle(picture, (x, y), (x + w, y + h), WINDOW_COLOUR, 1, cv2.LINE_AA)
        blob = (cycle.observation.left, cycle.observation.right)[side]
        if blob is not None:
            long, short, angle = blob.ellipse
            centre = (float(scale * blob.centre[0]), float(scale * blob.centre[1]))
            ellipse = (centre, (scale * long, scale * short), float(np.degrees(angle)))
            cv2.ellipse(picture, ellipse, OUTLINE_COLOUR, 1, cv2.LINE_AA)
    return picture


def _text_strip(cycle: LoopCycle) -> Image:
    """Time, state and the target's status in one line."""
    strip = np.full((STRIP_HEIGHT, 2 * WIDTH, 3), 30, np.uint8)
    tone = STATE_COLOURS.get(cycle.state.value, WHITE)
    status = "" if cycle.observation is None else cycle.observation.status
    pictures = status if cycle.pair is not None else "no pictures"
    text = f"{cycle.t:6.2f} s   {cycle.state.value.upper()}   target: {pictures}"
    cv2.putText(strip, text, (12, 27), cv2.FONT_HERSHEY_SIMPLEX, 0.6, tone, 1, cv2.LINE_AA)
    return strip
