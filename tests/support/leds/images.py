"""Pictures of LEDs with known centres, and the Cramér-Rao bound of their centres.

Its own optics (exact pixel integrals of Gaussians; discs by sub-pixel sums) and its own sensor
(shot noise, read noise, rounding, clipping), none of it shared with the detector.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from scipy.special import erf
from scipy.stats import norm

from verify.core.records import Array, Image

REACH = 22  # px rendered around a spot
PATCH = (2 * REACH + 1, 2 * REACH + 1)
FINE = 8  # sub-pixels a side; blurred over several of them afterwards


@dataclass(frozen=True)
class Sensor:
    """Variance read² + gain · signal, in DN²; black is what is subtracted before clipping at 0."""

    read: float = 1.5
    gain: float = 1 / 32
    black: float = 0.0

    def expose(self, light: Array, rng: np.random.Generator) -> Image:
        sigma = np.sqrt(self.read**2 + self.gain * light)
        noisy = light - self.black + sigma * rng.normal(size=light.shape)
        return np.clip(np.rint(noisy), 0, 255).astype(np.uint8)

    def information(self, light: Array) -> Array:
        """Fisher information of one rounded, clipped pixel on its own mean."""
        at = np.linspace(0, max(float(light.max()), 300.0) + 1, 4001)
        h = 1e-3

        def probabilities(mean: Array) -> Array:
            sigma = np.sqrt(self.read**2 + self.gain * np.maximum(mean, 0))[:, None]
            edges = np.r_[-np.inf, np.arange(0.5, 255), np.inf]
            return np.diff(norm.cdf((edges - (mean - self.black)[:, None]) / sigma), axis=1)

        p = probabilities(at)
        slope = (probabilities(at + h) - probabilities(at - h)) / (2 * h)
        information = np.sum(np.where(p > 1e-12, slope**2 / np.maximum(p, 1e-12), 0), axis=1)
        return np.interp(light, at, information)


@dataclass(frozen=True)
class Spot:
    peak: float
    blur: float  # sigma, px
    radius: float = 0.0  # px of the disc that is blurred; 0 is a point

    def light(self, shape: tuple[int, int], x: float, y: float) -> Array:
        """Light on each pixel of a patch, centred at x, y."""
        column, row = np.arange(shape[1]), np.arange(shape[0])
        if self.radius == 0:

            def line(axis: Array, centre: float) -> Array:
                edge = np.append(axis - 0.5, axis[-1] + 0.5) - centre
                share = np.diff(erf(edge / (np.sqrt(2) * self.blur))) / 2
                return share * self.blur * np.sqrt(2 * np.pi)

            return self.peak * np.outer(line(row, y), line(column, x))
        return self.part((shape[0], shape[1]), x, y, 0.0)

    def part(
        self,
        shape: tuple[int, int],
        x: float,
        y: float,
        side: float,
        *,
        hidden: float = 0.0,
        ratio: float = 1.0,
    ) -> Array:
        """Light of a disc whose share in direction `side`, rad, an edge hides, or an angle narrows.

        `hidden`, of its diameter; `ratio`, of its width there to that across.
        """
        centre = (np.arange(max(shape) * FINE) + 0.5) / FINE - 0.5
        dx, dy = centre[None, : shape[1] * FINE] - x, centre[: shape[0] * FINE, None] - y
        along = dx * np.cos(side) + dy * np.sin(side)
        across = dy * np.cos(side) - dx * np.sin(side)
        disc = np.clip((self.radius - np.hypot(along / ratio, across)) * FINE + 0.5, 0, 1)
        if hidden > 0:
            disc *= np.clip(((1 - 2 * hidden) * self.radius - along) * FINE + 0.5, 0, 1)
        soft = cv2.GaussianBlur(disc, (0, 0), self.blur * FINE)
        pixels = soft.reshape(shape[0], FINE, shape[1], FINE).mean(axis=(1, 3))
        return np.asarray(self.peak * pixels, dtype=float)


def through_jpeg(image: Image, quality: int) -> Image:
    """A picture as a JPEG, or MJPEG, leaves it."""
    packed = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality])[1]
    return np.asarray(cv2.imdecode(packed, cv2.IMREAD_UNCHANGED), dtype=np.uint8)


def centre_bound(spot: Spot, floor: float, sensor: Sensor) -> float:
    """Cramér-Rao bound of a coordinate, px; peak, floor and blur unknown too."""
    shape, half = PATCH, REACH
    bounds = []

    def light(
        at: tuple[float, float], dx: float, dy: float, peak: float, up: float, blur: float
    ) -> Array:
        trial = Spot(spot.peak + peak, spot.blur + blur, spot.radius)
        return floor + up + trial.light(shape, half + at[0] + dx, half + at[1] + dy)

    for at in ((0.1, 0.3), (-0.4, 0.2), (0.0, -0.2)):
        step = 1e-2
        columns = [
            (light(at, *(step * e)) - light(at, *(-step * e))) / (2 * step) for e in np.eye(5)
        ]
        jacobian = np.column_stack([c.ravel() for c in columns])
        weight = sensor.information(light(at, 0, 0, 0, 0, 0)).ravel()
        covariance = np.linalg.inv(jacobian.T @ (weight[:, None] * jacobian))
        bounds.append((covariance[0, 0] + covariance[1, 1]) / 2)
    return float(np.sqrt(np.mean(bounds)))


def picture(
    spots: list[Spot],
    centres: Array,
    sensor: Sensor,
    rng: np.random.Generator,
    shape: tuple[int, int] = (360, 640),
    floor: float | Array = 6.0,
) -> Image:
    """One exposure of spots at given centres (n, 2)."""
    light = np.zeros(shape) + floor
    for spot, (x, y) in zip(spots, centres, strict=True):
        x0, y0 = max(round(x) - REACH, 0), max(round(y) - REACH, 0)
        part = light[y0 : y0 + 2 * REACH + 1, x0 : x0 + 2 * REACH + 1]
        part += spot.light((part.shape[0], part.shape[1]), x - x0, y - y0)
    return sensor.expose(light, rng)


def scattered(rows: int, columns: int, rng: np.random.Generator, pitch: float = 70.0) -> Array:
    """Centres on a grid, each at a random place within its pixel."""
    grid = np.stack(np.meshgrid(np.arange(columns), np.arange(rows)), axis=-1).reshape(-1, 2)
    return np.asarray(45 + pitch * grid + rng.uniform(-0.5, 0.5, (len(grid), 2)))
