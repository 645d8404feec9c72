from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from reports.results import Results
from reports.session.document import document
from reports.session.headline import headline
from reports.session.times import FIRST_PAIR, from_first_pair
from tests.support.reports import session as made

STEP = {
    "kind": "step", "joint": 2, "value": 0.8, "unit": "deg", "t_s": 7.0,
    "runner_up": {"kind": "drift", "joint": 2, "t_s": 6.5},
}  # fmt: skip


def on_a_clock(first: float) -> Results:
    """Make a session whose joint 2 steps 7 s after its first pair; that is at `first` s."""
    results = made.nonconforming()
    begins = results.table("frames")["t_s"].min()
    tables = {
        name: table.assign(t_s=table["t_s"] - begins + first) if "t_s" in table else table
        for name, table in results.tables.items()
    }
    runner_up = STEP["runner_up"] | {"t_s": 6.5 + first}
    step = STEP | {"t_s": 7.0 + first, "runner_up": runner_up}
    return replace(results, summary=results.summary | {"diagnosis": [step]}, tables=tables)


@pytest.mark.parametrize("first", [0.0, 20_262.0, 1.7e9])
def test_a_person_reads_times_from_the_first_pair_on_any_clock(first: float) -> None:
    told = on_a_clock(first)
    shown = from_first_pair(told)
    assert shown.table("frames")["t_s"].min() == 0
    assert shown.summary[FIRST_PAIR] == first
    assert_allclose(shown.summary["diagnosis"][0]["t_s"], 7.0)
    assert_allclose(shown.summary["diagnosis"][0]["runner_up"]["t_s"], 6.5)
    assert told.table("frames")["t_s"].min() == first  # what is written stays as it was recorded
    assert from_first_pair(shown) is shown
    assert "7.0 s after the first pair" in headline(told).sentence
    assert f"t_s = {first:.3f} s in frames.csv" in str(document(told))


def test_results_without_times_stay_as_they_are() -> None:
    results = made.nonconforming()
    untimed = results.tables | {"frames": results.table("frames").assign(t_s=np.nan)}
    timeless = replace(results, tables=untimed)
    assert from_first_pair(timeless) is timeless
