"""False alarms of robots without fault, and how soon a jump is found, against what is stated.

python -m tests.bench.alarms [HOURS [CHAIN_SECONDS]]

First by numbers alone: twists with noise, some of it repeating itself, and biases of the size that
rig and LEDs state. Then through the chain from true LED images, clock and alignment included.
"""

import itertools
import math
import sys
import time
from collections.abc import Iterator

from tests.support.spot_level import RATE, SpotRun, facing_rig, streamed
from verify.live.alarms.joints import AlarmLimits, JointAlarms

HOURS = 10.0
CHAIN_SECONDS = 600.0
STATED = (0.1, 10.0)  # an hour; many, so that there is something to count
REPEATING = (0.0, 0.5, 0.9)
CHUNK = 0.5  # hours a robot


def main(hours: float = HOURS, chain_seconds: float = CHAIN_SECONDS) -> None:
    """Print a line an experiment."""
    for repeating, stated in itertools.product(REPEATING, STATED):
        share = hours / len(REPEATING) / len(STATED)
        print(by_numbers(share, stated, repeating), flush=True)
    for line in through_the_chain(chain_seconds):
        print(line, flush=True)


def by_numbers(hours: float, stated: float, repeating: float) -> str:
    """Count false alarms over some hours."""
    begin, found = time.perf_counter(), 0
    robots = max(round(hours / CHUNK), 1)
    for seed in range(robots):
        watch = JointAlarms(6, AlarmLimits(stated, RATE, None), itertools.count(1))
        rows = streamed(3600.0 * hours / robots, seed, repeating=repeating)
        found += sum(not a.revised for row in rows for a in watch.take(row, row.t))
    spent = time.perf_counter() - begin
    return (
        f"{hours:.2f} h, noise repeats {repeating:g}: {found} false alarms, "
        f"{hours * stated:.1f} are stated ({3600 * hours / spent:.0f} times real time)"
    )


def through_the_chain(seconds: float) -> Iterator[str]:
    """Watch a healthy robot, then one whose joint 4 jumps, at spot level."""
    rig, marker = facing_rig()
    for skew in (0.0, 0.004):
        run = SpotRun(rig, marker, RATE, skew)
        _, found, _ = run.watch(seconds, AlarmLimits(STATED[-1], RATE, None))
        output = [a for a in found if not a.revised]
        yield (
            f"chain, {seconds:g} s, skew {skew * 1e3:g} ms: {len(output)} false alarms, "
            f"{seconds / 3600 * STATED[-1]:.2f} are stated: {[a.text for a in output]}"
        )
        jumping = SpotRun(rig, marker, RATE, skew, (20.0, 4, math.radians(0.5)))
        _, found, _ = jumping.watch(22.0, AlarmLimits(STATED[0], RATE, None))
        yield f"0.5° in joint 4 at 20 s: {[(round(a.t, 3), a.text) for a in found]}"


if __name__ == "__main__":
    main(*(float(word) for word in sys.argv[1:]))
