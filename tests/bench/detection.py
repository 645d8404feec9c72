"""Processor time that detection takes, beside thresholding, contours and moments of the same frame.

A frame of 1280 x 720 shows four LEDs and what is none: a lamp, streaks, dim and tiny spots. The
centres of the pictures that are searched in windows are compared with the Cramér-Rao bound.
"""

from collections.abc import Callable, Iterator
from statistics import median
from time import process_time

import cv2
import numpy as np

from tests.bench.goals import Figure
from tests.support.leds.images import Sensor, Spot, centre_bound, picture
from verify.core.records import Array, Image
from verify.measurement.detection.detect import detect

ROUNDS = 60  # interleaved, so that a busy machine slows all alike
WINDOW = 20  # px around a predicted place
LED, FLOOR = Spot(210, 0.6, radius=4.2), 6.0
CENTRES = np.array([[312.3, 207.8], [540.6, 318.1], [733.2, 446.9], [905.4, 251.7]])
DISPARITY = np.array([61.4, -0.3])  # px, to the right picture
TRIALS = 40  # pairs: 640 coordinates, whose rms is known to 3 %
MAX_WHOLE = 2.0  # times the simple way
MAX_PAIR_MS = 0.3
UNIT_MS = 0.21  # of the simple way, on the machine that goals in milliseconds were set on
MAX_RMS = 1.05  # times the bound


def lines() -> Iterator[Figure]:
    """Each task beside thresholding, contours and moments; the centres beside their bound."""
    rng = np.random.default_rng(1)
    frame = cluttered_frame(rng)
    pair = [
        picture([LED] * 4, at, Sensor(), rng, (720, 1280), FLOOR)
        for at in (CENTRES, CENTRES - DISPARITY)
    ]
    windows = [np.hstack([at - WINDOW, at + WINDOW]) for at in (CENTRES, CENTRES - DISPARITY)]
    noise = detect(frame).noise
    tasks: dict[str, Callable[[], object]] = {
        "threshold, contours, weighted moments": lambda: simple_centres(frame),
        "whole frame": lambda: detect(frame),
        "whole frame, noise known": lambda: detect(frame, noise=noise),
        "four windows a picture, a pair": lambda: list(map(detect, pair, windows)),
        "four windows a picture, a pair, noise known": lambda: [
            detect(*one, noise=noise) for one in zip(pair, windows, strict=True)
        ],
    }
    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)
    seconds = medians(tasks, ROUNDS)
    cv2.setNumThreads(threads)
    unit = seconds["threshold, contours, weighted moments"]
    goals = {
        "whole frame": MAX_WHOLE,
        "four windows a picture, a pair, noise known": MAX_PAIR_MS / UNIT_MS,
    }
    for name, taken in seconds.items():
        beside = f"{name}, over threshold + contours + moments"
        yield Figure(beside, taken / unit, most=goals.get(name), note=f"{1e3 * taken:.2f} ms")
        if name.endswith("pair, noise known"):
            yield Figure(name, 1e3 * taken, "ms", most=MAX_PAIR_MS)
    ratio = rms_of_centres(rng) / centre_bound(LED, FLOOR, Sensor())
    yield Figure("rms of centres over the Cramér-Rao bound", ratio, most=MAX_RMS, note="± 0.03")


def cluttered_frame(rng: np.random.Generator) -> Image:
    """Four LEDs, and what is none."""
    light = np.full((720, 1280), FLOOR)
    cv2.circle(light, (150, 560), 45, 240.0, -1)  # a lamp
    cv2.line(light, (900, 600), (1180, 540), 180.0, 3)  # streaks
    cv2.line(light, (420, 90), (470, 190), 120.0, 2)
    dim = rng.uniform([40, 40], [1240, 680], (12, 2)).round().astype(int)
    for x, y in dim.tolist():  # spots below the least contrast, and single pixels
        cv2.circle(light, (x, y), 5, FLOOR + 12.0, -1)
        light[y - 20, x - 20] = 60.0
    return picture([LED] * 4, CENTRES, Sensor(), rng, (720, 1280), light)


def simple_centres(frame: Image) -> list[tuple[float, float]]:
    """Centres (x, y), px, by threshold, contours and moments of the brightness in their boxes."""
    _, above = cv2.threshold(frame, 60, 255, cv2.THRESH_BINARY)
    contours, _ = cv2.findContours(above, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE)
    found = []
    for contour in contours:
        x, y, width, height = cv2.boundingRect(contour)
        moment = cv2.moments(frame[y : y + height, x : x + width])
        found.append((x + moment["m10"] / moment["m00"], y + moment["m01"] / moment["m00"]))
    return found


def rms_of_centres(rng: np.random.Generator) -> float:
    """Rms error of a coordinate, px, of LEDs that are searched in windows."""
    errors: list[Array] = []
    for _ in range(2 * TRIALS):
        at = CENTRES + rng.uniform(-0.5, 0.5, CENTRES.shape) - [200.0, 150.0]
        found = detect(
            picture([LED] * 4, at, Sensor(), rng, (360, 760), FLOOR),
            np.hstack([at - WINDOW, at + WINDOW]),
        ).centre
        nearest = np.argmin(np.linalg.norm(found[None] - at[:, None], axis=2), axis=1)
        errors.append(found[nearest] - at)
    return float(np.sqrt(np.mean(np.square(errors))))


def medians(tasks: dict[str, Callable[[], object]], rounds: int) -> dict[str, float]:
    """Median processor time of each task, s; they take turns within the same run."""
    seconds: dict[str, list[float]] = {name: [] for name in tasks}
    for _ in range(rounds):
        for name, task in tasks.items():
            begin = process_time()
            task()
            seconds[name].append(process_time() - begin)
    return {name: median(taken) for name, taken in seconds.items()}
