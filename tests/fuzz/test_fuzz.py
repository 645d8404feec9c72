"""A sample of `make fuzz`: a hundred broken files, each of its own seed."""

from pathlib import Path

import pytest

from tests.fuzz.promise import run_case
from tests.fuzz.targets import make_targets

CASES = 100


@pytest.mark.slow
def test_what_is_broken_is_refused_in_one_line_or_changes_no_figure(tmp_path: Path) -> None:
    targets = make_targets(tmp_path / "targets")
    cases = [run_case(targets, seed, tmp_path / str(seed)) for seed in range(CASES)]
    assert [str(case) for case in cases if case.broken] == []
