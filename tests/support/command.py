"""Run a command as a user types it, in this process, and give back what the user would see.

Measure a session's pixels once, and ask many things of the measurements.
"""

import io
import json
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from reports import Results
from verify import analyse, open_session
from verify.analysis import session
from verify.cli.main import main
from verify.core.records import Array, Measurement

ROOT = Path(__file__).parents[2]
SAMPLES = ROOT / "sample_sessions"


@cache
def sample_results(name: str) -> Results:
    """Results of a sample session, analysed once in a process. Do not change them."""
    return analyse(open_session(SAMPLES / name))


@dataclass(frozen=True)
class Outcome:
    status: int
    out: str
    err: str

    @property
    def refusal(self) -> str:
        """The one line of a refusal; status 2, no traceback."""
        assert self.status == 2, self
        assert "Traceback" not in self.err
        (line,) = [line for line in self.err.splitlines() if line.startswith("error: ")]
        return line


def verify(*words: str | Path) -> Outcome:
    out, err = io.StringIO(), io.StringIO()
    with redirect_stdout(out), redirect_stderr(err), pytest.raises(SystemExit) as stop:
        main([str(w) for w in words])
    code = stop.value.code
    return Outcome(code if isinstance(code, int) else 0, out.getvalue(), err.getvalue())


@dataclass(frozen=True)
class Run:
    """What one `verify run` printed and wrote, and what it measured on the way."""

    folder: Path
    out: Path
    outcome: Outcome
    measurements: list[Measurement]

    @property
    def summary(self) -> dict[str, Any]:
        return read_summary(self.out)

    @property
    def frames(self) -> pd.DataFrame:
        return pd.read_csv(self.out / "frames.csv")

    def joints(self, key: str) -> Array:
        return np.array([joint[key] for joint in self.summary["joints"]], dtype=float)


def read_summary(out: Path) -> dict[str, Any]:
    return dict(json.loads((out / "summary.json").read_text(encoding="utf-8")))


def run(folder: Path, out: Path, *options: str) -> Run:
    with remembered() as measurements:
        outcome = verify("run", folder, "-o", out, *options)
    return Run(folder, out, outcome, measurements)


@contextmanager
def remembered() -> Iterator[list[Measurement]]:
    """Keep every measurement that is made meanwhile."""
    seen: list[Measurement] = []
    plain = session.measure

    def kept(*arguments: Any) -> Iterator[Measurement]:
        for measurement in plain(*arguments):
            seen.append(measurement)
            yield measurement

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(session, "measure", kept)
        yield seen


@contextmanager
def replayed(seen: list[Measurement]) -> Iterator[None]:
    """Let the chain answer with these measurements instead of looking at pictures."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(session, "measure", lambda *_: iter(seen))
        yield
