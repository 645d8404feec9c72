"""How long detection takes, as a ratio to thresholding and labelling the same frame."""

from collections.abc import Callable, Iterator
from statistics import median
from time import perf_counter

import cv2
import numpy as np

from tests.support.leds.images import Sensor, Spot, picture
from verify.measurement.detection.detect import detect

ROUNDS = 15  # interleaved, so that a busy machine slows all alike
WINDOW = 20  # px around a predicted place


def lines() -> Iterator[str]:
    """One line a figure."""
    rng = np.random.default_rng(1)
    centres = np.array([[312.3, 207.8], [540.6, 318.1], [733.2, 446.9], [905.4, 251.7]])
    disc = Spot(210, 0.6, radius=4.2)
    frame = picture([disc] * 4, centres, Sensor(), rng, shape=(720, 1280))
    windows = np.hstack([centres - WINDOW, centres + WINDOW])
    noise = detect(frame).noise

    def threshold() -> None:
        _, above = cv2.threshold(frame, 60, 255, cv2.THRESH_BINARY)
        cv2.connectedComponentsWithStats(above)

    tasks: dict[str, Callable[[], object]] = {
        "threshold and connected components": threshold,
        "whole frame": lambda: detect(frame),
        "whole frame, noise known": lambda: detect(frame, noise=noise),
        "four windows, noise known": lambda: detect(frame, windows, noise=noise),
    }
    seconds = medians(tasks, ROUNDS)
    unit = seconds["threshold and connected components"]
    for name, taken in seconds.items():
        yield f"detection, {name}: {taken / unit:.2f} ({1e3 * taken:.2f} ms)"


def medians(tasks: dict[str, Callable[[], object]], rounds: int) -> dict[str, float]:
    """Median seconds of each task; they take turns within the same run."""
    seconds: dict[str, list[float]] = {name: [] for name in tasks}
    for _ in range(rounds):
        for name, task in tasks.items():
            begin = perf_counter()
            task()
            seconds[name].append(perf_counter() - begin)
    return {name: median(taken) for name, taken in seconds.items()}
