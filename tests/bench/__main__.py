"""Every benchmark in one run, as ratios: `make bench`.

python -m tests.bench [NAME…]     detection, corners, chain, ik, memory, tracking, batch,
                                  monte_carlo; or all
"""

import sys
from collections.abc import Callable, Iterator

from tests.bench import batch, chain, corners, detection, ik, memory, monte_carlo, tracking

MODULES = (detection, corners, chain, ik, memory, tracking, batch, monte_carlo)
BENCHES: dict[str, Callable[[], Iterator[str]]] = {
    module.__name__.rpartition(".")[2]: module.lines for module in MODULES
}


def main(names: list[str]) -> int:
    """Print each benchmark's lines under its name; 2 for a name that is none."""
    unknown = sorted(set(names) - set(BENCHES))
    if unknown:
        print(f"no benchmark is called {', '.join(unknown)}; there are {', '.join(BENCHES)}")
        return 2
    for name in names or list(BENCHES):
        print(f"{name}:", flush=True)
        for line in BENCHES[name]():
            print(f"  {line}", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
