"""Every benchmark in one run, as ratios, with goals: `make bench`.

    python -m tests.bench [NAME…] [-o FILE]   some or all; FILE, build/bench.json, gets JSON
    python -m tests.bench page [FILE]         its figures into docs/performance-of-the-program.md

Each runs in a process of its own: none measures what another has loaded. Status 1: a goal is
missed, or a benchmark failed.
"""

import json
import os
import subprocess
import sys
from importlib import import_module
from pathlib import Path

from tests.bench import store
from tests.bench.goals import Figure

NAMES = (
    "detection", "corners", "chain", "ik", "memory", "tracking", "batch", "monte_carlo", "session",
    "identification", "growth",
)  # fmt: skip
HERE = "--here"


def main(words: list[str]) -> int:
    """Run benchmarks, then print every goal; 2 for a name that is none."""
    if words[:1] == ["page"]:
        store.write_page(*map(Path, words[1:2]))
        return 0
    if words[:1] == [HERE]:
        return here(words[1], Path(words[2]))
    path = store.FILE
    if "-o" in words[:-1]:
        at = words.index("-o")
        path, words = Path(words[at + 1]), words[:at] + words[at + 2 :]
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # as the command itself does
    unknown = sorted(set(words) - set(NAMES))
    if unknown:
        print(f"no benchmark is called {', '.join(unknown)}; there are {', '.join(NAMES)}")
        return 2
    names = words or NAMES
    failed = [name for name in names if _apart(name, path)]
    print(f"{path}\ngoals:")
    records = json.loads(path.read_text()) if path.is_file() else {"benches": {}}
    held = [name for name in names if name not in failed]
    found = [figure for name in held for figure in store.figures(records, name) if figure.goal]
    for figure in found:
        print(f"  {figure}")
    for name in failed:
        print(f"  {name} ended early")
    return int(bool(failed) or not all(figure.holds for figure in found))


def here(name: str, path: Path) -> int:
    """Run a benchmark in this process: print its lines, keep its figures."""
    print(f"{name}:", flush=True)
    found = []
    for line in import_module(f"tests.bench.{name}").lines():
        print(f"  {line}", flush=True)
        if isinstance(line, Figure):
            found.append(line)
    store.keep(path, name, found)
    return 0


def _apart(name: str, path: Path) -> int:
    words = [sys.executable, "-m", "tests.bench", HERE, name, str(path)]
    return subprocess.run(words, check=False).returncode


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
