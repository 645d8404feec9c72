"""Two hundred broken files of every kind: the promise holds."""

from pathlib import Path

import pytest

from tests.fuzz.promise import Target, make_targets, run_case

SEEDS, PART = 200, 20


@pytest.fixture(scope="module")
def targets(tmp_path_factory: pytest.TempPathFactory) -> list[Target]:
    return make_targets(tmp_path_factory.mktemp("whole"))


@pytest.mark.slow
@pytest.mark.parametrize("first", range(0, SEEDS, PART))
def test_broken_input_is_one_line_or_changes_nothing_unsaid(
    targets: list[Target], first: int, tmp_path: Path
) -> None:
    for seed in range(first, first + PART):
        case = run_case(targets, seed, tmp_path / str(seed))
        assert not case.broken, f"seed {seed}: {case}"
