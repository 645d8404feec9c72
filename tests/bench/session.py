"""A session's whole command: warm, with its reports, and the first on a fresh machine.

Warm: the best of several runs, processes started anew. First: the inner loops are not
compiled; what counts is processor time, of all processes together.

    python -m tests.bench session
"""

import os
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

from tests.bench.chain import SAMPLE
from tests.bench.goals import Figure
from verify.core.native import library_folder

ROUNDS = 7
MOST_WARM_S, MOST_FIRST_S = 3.0, 30.0


def lines() -> Iterator[Figure]:
    """Time the command on the sample session of 60 pairs."""
    with tempfile.TemporaryDirectory() as place:
        out = Path(place) / "out"
        command("run", str(SAMPLE), "-o", str(out), "--tolerance", "0.2")  # compiles and loads
        spent = [command("run", str(SAMPLE), "-o", str(out), "--force", "--tolerance", "0.2")
                 for _ in range(ROUNDS)]  # fmt: skip
        wall, processor = (min(times) for times in zip(*spent, strict=True))
        note = f"best of {ROUNDS}"
        yield Figure("60 pairs with reports, warm", wall, "s", most=MOST_WARM_S, note=note)
        yield Figure("60 pairs with reports, warm, processor time", processor, "s", note=note)
        shutil.rmtree(library_folder())  # it is compiled anew
        fresh = Path(place) / "fresh"
        _, first = command("run", str(SAMPLE), "-o", str(fresh), "--tolerance", "0.2")
        name = "first run on a fresh machine, processor time"
        yield Figure(name, first, "s", most=MOST_FIRST_S)


def command(*words: str) -> tuple[float, float]:
    """Run `verify` as a user does; seconds by the clock and of processor time, with children.

    Python keeps what it has compiled, unless a container forbids it.
    """
    kept = {k: v for k, v in os.environ.items() if k != "PYTHONDONTWRITEBYTECODE"}
    before, begun = _processor(), time.perf_counter()
    done = subprocess.run(
        [sys.executable, "-m", "verify", *words], env=kept, capture_output=True, text=True,
        check=False,
    )  # fmt: skip
    assert done.returncode in (0, 1, 3), done.stderr  # a verdict
    return time.perf_counter() - begun, _processor() - before


def _processor() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime
