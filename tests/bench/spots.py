"""Do the covariances of spots hold the truth where an LED is not alone, or not whole?

Kinds: two LEDs that overlap, by separation in widths at half height; an LED behind a straight edge,
by the share of its width that is hidden, where its picture can show that; LEDs before a room with
texture, or before a bright edge.
Each picture holds twelve LEDs, a third of them spoilt, at random directions, sharp or blurred. Two
figures a kind: the share of centres inside the ellipse of 95 %, and of coordinates inside 1.96 u,
with its standard error between pictures; beside them the shares flagged merged and found. A kind
fails where the share of coordinates is clearly too small: among so many kinds, chance takes some
below any limit.

    python -m tests.bench.spots [PICTURES] [SEED]
"""

import os
import sys
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field, replace
from functools import cache, partial

import numpy as np
from scipy.ndimage import gaussian_filter
from scipy.stats import chi2
from scipy.stats import t as student_t

from tests.bench.cells import LOW, SEEDS, WITHIN, conclude
from tests.support.leds.images import PATCH, REACH, Sensor, Spot
from verify.core.records import Array
from verify.measurement.detection.detect import detect

PICTURES = 60
SHAPE = (360, 640)
LEDS = {
    "sharp": Spot(200, 0.6, radius=4.2),
    "small": Spot(200, 0.6, radius=2.2),
    "blurred": Spot(200, 2.2, radius=3.0),
}
SEPARATIONS = (0.6, 0.8, 1.0, 1.2, 1.4, 1.7, 2.0, 2.5)  # widths
SHOWS = 5.0  # standard deviations of what a hidden part does beyond any whole LED
FLOOR = 6.0  # DN
RATIOS = (1.0, 0.5, 0.2)  # of brightness
HIDDEN = ((0.0, 0.1), (0.1, 0.2), (0.2, 0.35), (0.35, 0.5), (0.5, 0.7))  # of the width
ELLIPSE = float(chi2.ppf(0.95, 2))


@dataclass
class Count:
    """What became of the LEDs of a kind."""

    picture: list[int] = field(default_factory=list)
    d2: list[float] = field(default_factory=list)
    z: list[Array] = field(default_factory=list)
    off: list[float] = field(default_factory=list)
    merged: list[bool] = field(default_factory=list)
    missed: int = 0

    @property
    def share(self) -> tuple[float, float, float]:
        """Share of coordinates inside, its standard error, and how far it may be off (95 %)."""
        inside, picture = np.mean(np.abs(self.z) < WITHIN, axis=1), np.array(self.picture)
        share, count = float(inside.mean()), len(np.unique(picture))
        if count < 2:
            return share, 1.0, 1.0
        # LEDs of one picture share its noise: a ratio of sums over pictures
        sums = np.bincount(picture, inside - share)
        error = float(np.sqrt(count / (count - 1) * np.sum(sums**2)) / len(inside))
        return share, error, float(student_t.ppf(0.975, count - 1)) * error

    @property
    def fails(self) -> bool:
        """The share of coordinates is clearly too small."""
        share, _, reach = self.share if self.d2 else (1.0, 0.0, 0.0)
        return share + reach < LOW

    def line(self, name: str) -> str:
        """One line of figures."""
        if not self.d2:
            return f"  {name:24s} " + (
                "none found" if self.missed else "none that its picture can show"
            )
        inside, (share, error, _) = np.mean(np.array(self.d2) < ELLIPSE), self.share
        found = len(self.d2) / (len(self.d2) + self.missed)
        rms = np.sqrt(np.mean(np.square(self.off)))
        return (
            f"  {name:24s}{len(self.d2):5d}  ellipse {inside:6.1%}  coordinate {share:6.1%} ±"
            f" {error:4.1%}  merged {np.mean(self.merged):6.1%}  found {found:6.1%}"
            f"  rms {rms:.3f} px" + "  FAILS" * self.fails
        )


def width(spot: Spot) -> float:
    """Full width at half height, px."""
    side = 2 * REACH + 1
    light = spot.light((side, side), REACH, REACH)
    return 2 * float(np.sqrt(np.sum(light > light.max() / 2) / np.pi))


def add(light: Array, patch: Array, x: int, y: int) -> None:
    """Add light centred at a pixel."""
    light[y - REACH : y + REACH + 1, x - REACH : x + REACH + 1] += patch


def sites(rng: np.random.Generator) -> Array:
    """Twelve places far apart, (12, 2) px, shuffled."""
    grid = np.stack(np.meshgrid(np.arange(4), np.arange(3)), axis=-1).reshape(-1, 2)
    return np.asarray(rng.permutation([95, 65] + [150, 115] * grid + rng.uniform(-8, 8, (12, 2))))


def whole(light: Array, spot: Spot, place: Array) -> None:
    """Add a whole LED."""
    x, y = np.rint(place).astype(int)
    side = 2 * REACH + 1
    add(light, spot.light((side, side), place[0] - x + REACH, place[1] - y + REACH), x, y)


def count(
    light: Array, truth: Array, near: float, into: Count, picture: int, rng: np.random.Generator
) -> None:
    """Expose a picture and compare the nearest spot with each true centre (n, 2)."""
    spots = detect(Sensor().expose(light, rng))
    for point in truth:
        off = np.linalg.norm(spots.centre - point, axis=1)
        if not len(spots) or off.min() > near:
            into.missed += 1
            continue
        k = int(np.argmin(off))
        error = spots.centre[k] - point
        into.picture.append(picture)
        into.d2.append(float(error @ np.linalg.solve(spots.covariance[k], error)))
        into.z.append(error / np.sqrt(np.diag(spots.covariance[k])))
        into.off.append(float(off[k]))
        into.merged.append(bool(spots.merged[k]))


def overlapping(
    spot: Spot, apart: float, ratio: float, number: int, rng: np.random.Generator
) -> Count:
    """Count LEDs with another one beside them."""
    into = Count()
    distance = apart * width(spot)
    other = Spot(spot.peak * ratio, spot.blur, spot.radius)
    for picture in range(number):
        light, truth = np.full(SHAPE, FLOOR), []
        for n, place in enumerate(sites(rng)):
            whole(light, spot, place)
            if n % 3 == 0:
                side = rng.uniform(0, 2 * np.pi)
                beside = place + distance * np.array([np.cos(side), np.sin(side)])
                whole(light, other, beside)
                truth += [place, beside] if ratio == 1.0 else [place]
        count(light, np.array(truth), 0.8 * distance, into, picture, rng)
    return into


@cache
def least_hidden(spot: Spot) -> float:
    """Least share of an LED's width whose being hidden its picture can show at all.

    There the difference from the whole LED that fits best is SHOWS times the noise: less than that
    no look at one picture of the LED tells from a whole one elsewhere.
    """
    x, y, step = REACH + 0.1, REACH - 0.2, 1e-2
    light, (row, column) = spot.part(PATCH, x, y, 0.0), np.mgrid[: PATCH[0], : PATCH[1]] - REACH

    def derivative(of: Callable[[float], Array]) -> Array:
        return (of(step) - of(-step)) / (2 * step)

    free = [
        light, np.ones(PATCH), row, column,
        derivative(lambda s: spot.part(PATCH, x + s, y, 0.0)),
        derivative(lambda s: spot.part(PATCH, x, y + s, 0.0)),
        derivative(lambda s: replace(spot, blur=spot.blur + s).part(PATCH, x, y, 0.0)),
        derivative(lambda s: replace(spot, radius=spot.radius + s).part(PATCH, x, y, 0.0)),
        derivative(lambda s: spot.part(PATCH, x, y, 0.0, ratio=1 + s)),
        derivative(lambda s: spot.part(PATCH, x, y, np.pi / 4, ratio=1 + s)),
    ]  # fmt: skip
    weight = np.sqrt(Sensor().information(light + FLOOR))
    columns = np.stack([(weight * part).ravel() for part in free], axis=1)
    shares = np.linspace(0.0, 0.5, 26)
    shown = []
    for share in shares.tolist():
        off = (weight * (spot.part(PATCH, x, y, 0.3, hidden=share) - light)).ravel()
        fit = np.linalg.lstsq(columns, off, rcond=None)[0]
        shown.append(float(np.linalg.norm(off - columns @ fit)))
    return float(np.interp(SHOWS, shown, shares))


def hidden(spot: Spot, share: tuple[float, float], number: int, rng: np.random.Generator) -> Count:
    """Count LEDs behind an edge, of which as much is hidden as can show."""
    into = Count()
    for picture in range(number):
        light, truth = np.full(SHAPE, FLOOR), []
        for n, place in enumerate(sites(rng)):
            if n % 3:
                whole(light, spot, place)
                continue
            x, y = np.rint(place).astype(int)
            at = place - [x, y] + REACH
            less, side = rng.uniform(*share), rng.uniform(0, 2 * np.pi)
            add(light, spot.part(PATCH, *at, side, hidden=less), x, y)
            if less > least_hidden(spot):
                truth.append(place)
        count(light, np.array(truth), spot.radius + 1, into, picture, rng)
    return into


def before_a_room(
    spot: Spot, grain: float, depth: float, number: int, rng: np.random.Generator
) -> Count:
    """Count LEDs before texture of a grain (px) and standard deviation (DN), or edges (grain 0)."""
    into = Count()
    for picture in range(number):
        places = sites(rng)
        if grain:
            room = gaussian_filter(rng.normal(size=SHAPE), grain / 2, mode="wrap")
            light = 50.0 + depth * room / room.std()
        else:
            light = np.full(SHAPE, 30.0)
            row, column = np.mgrid[: SHAPE[0], : SHAPE[1]]
            for place in places[::3]:
                side, off = rng.uniform(0, 2 * np.pi), rng.uniform(-8, 8)
                across = (column - place[0]) * np.cos(side) + (row - place[1]) * np.sin(side)
                near = np.hypot(column - place[0], row - place[1]) < 50
                light += depth * np.clip(across - off + 0.5, 0, 1) * near
        for place in places:
            whole(light, Spot(180, spot.blur, spot.radius), place)
        count(light, places if grain else places[::3], 3.0, into, picture, rng)
    return into


def kinds() -> dict[str, Callable[[int, np.random.Generator], Count]]:
    """Every kind by its name."""
    every: dict[str, Callable[[int, np.random.Generator], Count]] = {}
    for name, spot in LEDS.items():
        for apart in SEPARATIONS:
            for ratio in RATIOS:
                every[f"{name} {apart:.1f} widths 1:{ratio:g}"] = partial(
                    overlapping, spot, apart, ratio
                )
        for share in HIDDEN:
            every[f"{name} hidden {share}"] = partial(hidden, spot, share)
        for grain in (24, 12, 6):
            for depth in (4, 15):
                every[f"{name} grain {grain} px {depth} DN"] = partial(
                    before_a_room, spot, grain, depth
                )
        every[f"{name} edge 30 DN"] = partial(before_a_room, spot, 0, 30)
    return every


def counted(name: str, number: int, seed: np.random.SeedSequence) -> Count:
    """Count one kind, in a process of its own."""
    return kinds()[name](number, np.random.default_rng(seed))


def main(number: int, seed: int) -> int:
    """Print every kind; how many fail."""
    names, failed = list(kinds()), 0
    seeds = np.random.SeedSequence(seed).spawn(len(names))
    with ProcessPoolExecutor(max_workers=os.cpu_count()) as pool:
        counts = pool.map(counted, names, [number] * len(names), seeds)
        for name, found in zip(names, counts, strict=True):
            print(found.line(name), flush=True)
            failed += found.fails
    return conclude(failed)


if __name__ == "__main__":
    os.environ["OMP_NUM_THREADS"] = "1"
    number, seed = (*map(int, sys.argv[1:]), *(PICTURES, SEEDS[0])[len(sys.argv) - 1 :])
    sys.exit(main(number, seed))
