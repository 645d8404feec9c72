"""How often the clock's offset is wrong: periodic motions, logs with and without arrival times.

python -m tests.bench.clock [RUNS]

A run is a repeating motion of 0.5 to 30 s, measured for 10 to 120 s at 15 pairs a second, and a log
at 100 Hz on a clock of its own. In half of the runs one joint's reading jumps on the way; half of
the logs hold arrival times. An offset is wrong where it is more than five expanded uncertainties
from the truth and the truth is not among the alternatives that the estimate lists.
"""

import sys
import time
from collections import Counter
from collections.abc import Callable

import numpy as np

from tests.support.motions import ARM, HOME, make_track
from verify.analysis.clock.estimate import ClockEstimate, clock_from_arrival_times, estimate_clock
from verify.core.readings import Readings
from verify.core.records import Array

RUNS = 200
PAIR_RATE, READING_RATE = 15.0, 100.0  # 1/s
MAX_ERROR = 5.0  # expanded uncertainties
MIN_ALTERNATIVE_ERROR = 0.01  # s: an alternative stands for the truth within this
MIN_QUICKEST, MEAN_DELIVERY = 5e-4, 4e-3  # s, of a reading


def random_motion(rng: np.random.Generator) -> tuple[float, Callable[[Array], Array]]:
    """A period, s, and joint angles (n, 6), rad, at instants (n,), s: two harmonics of it.

    No joint is quicker than 2 rad/s.
    """
    period = float(np.exp(rng.uniform(np.log(0.5), np.log(30.0))))
    reach = min(np.deg2rad(15.0), 2.0 * period / (2 * np.pi))
    size = rng.uniform(0.2, 1.0, (2, 6)) * reach / np.array([[1.5], [4.0]])
    phase = rng.uniform(0, 2 * np.pi, (2, 6))

    def motion(t: Array) -> Array:
        turn = 2 * np.pi * t[:, None] / period
        q: Array = HOME + sum(size[k] * np.sin((k + 1) * turn + phase[k]) for k in range(2))
        return q

    return period, motion


def simulate(seed: int) -> tuple[ClockEstimate, float, float, bool]:
    """Estimate one run's offset; the truth, s, the period, s, and whether arrivals were there."""
    rng = np.random.default_rng([seed, 19])
    period, motion = random_motion(rng)
    length = float(rng.uniform(10, 120))
    offset, margin = float(rng.uniform(-3, 3)), rng.uniform(0.3, 4.0, 2)
    pairs = np.arange(0.0, length, 1 / PAIR_RATE)
    log = np.arange(-margin[0], length + margin[1], 1 / READING_RATE)
    q = motion(log) + rng.normal(0, np.deg2rad(0.005), (len(log), 6))
    if seed % 2:
        q[log > rng.uniform(0.1, 0.9) * length, rng.integers(6)] += np.deg2rad(rng.uniform(0.1, 1))
    readings = Readings(log - offset, q)
    arrival = None
    if seed % 4 < 2:
        late = MIN_QUICKEST + rng.exponential(MEAN_DELIVERY, len(log))
        arrival = clock_from_arrival_times(readings.t, log + late)
    estimate = estimate_clock(make_track(pairs, motion(pairs), rng), ARM, readings, arrival)
    return estimate, offset, period, arrival is not None


def verdict(estimate: ClockEstimate, offset: float) -> str:
    """`right`, `listed` (the truth is among the alternatives), `open` or `wrong`."""
    error = abs(estimate.offset - offset)
    others = np.abs(np.array(estimate.rivals) - offset)
    if estimate.source == "ambiguous":
        near = min(error, others.min(initial=np.inf)) <= MIN_ALTERNATIVE_ERROR
        return "listed" if near else "wrong"
    if estimate.standard_uncertainty is None:
        return "open"
    return "right" if error <= MAX_ERROR * 2 * estimate.standard_uncertainty else "wrong"


def main(runs: int) -> None:
    """Print the counts, the worst cases and the time an estimate takes."""
    counts: Counter[tuple[str, str]] = Counter()
    ratios, seconds = [], []
    for seed in range(runs):
        began = time.perf_counter()
        estimate, offset, period, arrivals = simulate(seed)
        seconds.append(time.perf_counter() - began)
        outcome = verdict(estimate, offset)
        counts["arrival times" if arrivals else "none", outcome] += 1
        if estimate.standard_uncertainty and outcome == "right":
            ratios.append(abs(estimate.offset - offset) / estimate.standard_uncertainty)
        if outcome == "wrong":
            print(
                f"  run {seed}: period {period:.2f} s, true {offset:+.4f} s, "
                f"estimated {estimate.offset:+.4f} s ± {estimate.standard_uncertainty} "
                f"({estimate.source}, {len(estimate.rivals)} others)"
            )
    for (kind, outcome), count in sorted(counts.items()):
        print(f"{kind}: {outcome} {count}")
    print(f"error over standard uncertainty, rms {np.sqrt(np.mean(np.square(ratios))):.2f}")
    print(f"an estimate takes {np.median(seconds):.2f} s, at most {max(seconds):.2f} s")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else RUNS)
