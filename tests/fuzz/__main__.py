"""Break files and count broken promises: python -m tests.fuzz [N] [FIRST SEED] [TARGET ...].

A target is named by a part of its name, as "MJPEG" or "report of grab"; without one all are drawn.
"""

import faulthandler
import sys
import tempfile
from collections import Counter
from pathlib import Path

from tests.fuzz.promise import run_case
from tests.fuzz.targets import make_targets

CASES = 2000


def main(cases: int, first: int, names: list[str]) -> int:
    """Print each case that breaks the promise, then the counts; 1 if there is one."""
    counts: Counter[str] = Counter()
    with tempfile.TemporaryDirectory() as folder:
        targets = make_targets(Path(folder))
        drawn = [t for t in targets if not names or any(name in t.name for name in names)]
        for seed in range(first, first + cases):
            with tempfile.TemporaryDirectory() as place:
                case = run_case(drawn, seed, Path(place))
            status = "none" if case.outcome is None else str(case.outcome.status)
            counts[f"{case.target}: status {status}"] += 1
            if case.broken:
                counts["broken promises"] += 1
                print(f"seed {seed}: {case}", flush=True)
    for name, count in sorted(counts.items()):
        print(f"{name}: {count}")
    return int(counts["broken promises"] > 0)


if __name__ == "__main__":
    faulthandler.enable()
    numbers = [int(word) for word in sys.argv[1:3]]
    sys.exit(main(*(numbers + [CASES, 0][len(numbers) :]), sys.argv[3:]))
