"""What a fault would add beside a set: against fits of the larger set, by numpy."""

import numpy as np
import pytest

from verify.judgement.diagnosis_search import Products
from verify.judgement.faults import Fault

FREEDOM = [1, 2, 3, 1, 2, 6, 3, 1]
ROWS = 200


def products(columns: list[np.ndarray], error: np.ndarray) -> Products:
    """Products of faults that have these columns (r, f), with nothing fitted beside them."""
    whole = np.concatenate(columns, axis=1)
    scale = np.linalg.norm(whole, axis=0)
    whole = whole / scale
    ends = np.cumsum([c.shape[1] for c in columns])
    places = [np.arange(end - c.shape[1], end) for end, c in zip(ends, columns, strict=True)]
    count = len(columns)
    faults: list[Fault] = [None] * count  # type: ignore[list-item]  # nothing of them is asked
    return Products(
        faults, whole.T @ whole, whole.T @ error, float(error @ error), scale, ROWS, places,
        np.ones(count, dtype=np.bool_), np.zeros(count),
    )  # fmt: skip


@pytest.mark.parametrize("chosen", [(), (2,), (0, 4), (1, 5, 6)])
def test_what_a_fault_adds_is_what_a_fit_with_it_explains_more(chosen: tuple[int, ...]) -> None:
    rng = np.random.default_rng(1)
    columns = [rng.normal(size=(ROWS, f)) for f in FREEDOM]
    error = rng.normal(size=ROWS) + columns[2].sum(axis=1)
    added = products(columns, error).added(chosen)

    def misfit(faults: tuple[int, ...]) -> float:
        if not faults:
            return float(error @ error)
        design = np.concatenate([columns[i] for i in faults], axis=1)
        return float(np.sum((error - design @ np.linalg.lstsq(design, error)[0]) ** 2))

    expected = [misfit(chosen) - misfit(tuple({*chosen, i})) for i in range(len(columns))]
    np.testing.assert_allclose(added, expected, atol=1e-9)


def test_nothing_is_added_to_a_set_that_cannot_be_told_apart() -> None:
    rng = np.random.default_rng(2)
    first, other = rng.normal(size=(2, ROWS, 1))
    found = products([first, first.copy(), other], rng.normal(size=ROWS))
    assert not np.isfinite(found.chi2((0, 1)))
    assert found.added((0,))[1] == 0.0
    assert found.added((0,))[2] > 0.0
