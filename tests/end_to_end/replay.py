"""Measure a session's pixels once, and ask many things of the measurements."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest

from verify import analysis
from verify.records import Measurement


@contextmanager
def remembered() -> Iterator[list[Measurement]]:
    """Keep every measurement that is made meanwhile."""
    seen: list[Measurement] = []
    plain = analysis.measure

    def kept(*arguments: Any) -> Iterator[Measurement]:
        for measurement in plain(*arguments):
            seen.append(measurement)
            yield measurement

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(analysis, "measure", kept)
        yield seen


@contextmanager
def replayed(seen: list[Measurement]) -> Iterator[None]:
    """Let the chain answer with these measurements instead of looking at pictures."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(analysis, "measure", lambda *_: iter(seen))
        yield
