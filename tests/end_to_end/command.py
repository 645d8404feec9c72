"""Run a command as a user types it, in this process, and give back what the user would see."""

import io
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass
from pathlib import Path

import pytest

from verify.cli import main

ROOT = Path(__file__).parents[2]
SAMPLES = ROOT / "sample_sessions"


@dataclass(frozen=True)
class Outcome:
    status: int
    out: str
    err: str


def verify(*words: str | Path) -> Outcome:
    out, err = io.StringIO(), io.StringIO()
    with redirect_stdout(out), redirect_stderr(err), pytest.raises(SystemExit) as stop:
        main([str(w) for w in words])
    code = stop.value.code
    return Outcome(code if isinstance(code, int) else 0, out.getvalue(), err.getvalue())
