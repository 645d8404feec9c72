"""Break files and count broken promises: python -m tests.fuzz [N] [FIRST SEED]."""

import faulthandler
import sys
import tempfile
from collections import Counter
from pathlib import Path

from tests.fuzz.promise import run_case
from tests.fuzz.targets import make_targets

CASES = 2000


def main(cases: int, first: int) -> int:
    """Print each case that breaks the promise, then the counts; 1 if there is one."""
    counts: Counter[str] = Counter()
    with tempfile.TemporaryDirectory() as folder:
        targets = make_targets(Path(folder))
        for seed in range(first, first + cases):
            with tempfile.TemporaryDirectory() as place:
                case = run_case(targets, seed, Path(place))
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
    numbers = [int(word) for word in sys.argv[1:]]
    sys.exit(main(*(numbers + [CASES, 0][len(numbers) :])))
