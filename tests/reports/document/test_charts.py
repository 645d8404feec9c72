import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from reports.document.charts import (
    MAX_LINE_POINTS,
    N_BINS,
    band,
    column,
    count_ticks,
    isolated_points,
    pieces,
    runs,
    time_axis,
    trace,
    unwrap_rotation,
)


def test_a_line_breaks_where_a_pair_was_not_measured_or_has_no_row() -> None:
    x, y = trace(np.arange(5.0), np.array([1, 2, np.nan, 4, 5]))
    assert_allclose(y, [1, 2, np.nan, 4, 5])
    assert np.isnan(x[2])
    t = np.array([0.0, 0.1, 0.2, 0.9, 1.0])
    assert_allclose(trace(t, np.arange(5.0))[1], [0, 1, 2, np.nan, 3, 4])


@pytest.mark.parametrize(
    ("numbers", "words"),
    [
        ([1.0, 2.0], ["1", "2"]),
        ([3.0], ["3"]),
        ([0.0, np.nan, 19.0], ["0", "5", "10", "15"]),
        ([1.0, 12.0], ["2", "4", "6", "8", "10", "12"]),
        ([np.nan], []),
    ],
)
def test_an_axis_that_counts_has_whole_numbers(numbers: list[float], words: list[str]) -> None:
    ticks = count_ticks(np.array(numbers))
    assert [word for _, word in ticks] == words
    assert [place for place, _ in ticks] == [float(word) for word in words]


def test_a_point_without_neighbours_is_not_lost() -> None:
    x, y = trace(np.arange(5.0), np.array([1, np.nan, 3, np.nan, np.nan]))
    assert_allclose(y[isolated_points(x, y)], [1, 3])


@settings(max_examples=25)
@given(
    st.integers(0, 2**32 - 1),
    st.integers(MAX_LINE_POINTS + 1, 3 * MAX_LINE_POINTS),
    st.floats(0.0, 0.3),
)
def test_thinning_keeps_every_extreme_and_invents_nothing(seed: int, n: int, lost: float) -> None:
    random = np.random.default_rng(seed)
    y = random.standard_normal(n)
    y[random.random(n) < lost] = np.nan
    t = np.arange(n) * 0.1
    x_kept, y_kept = trace(t, y)
    known = np.isfinite(y_kept)
    assert known.sum() <= MAX_LINE_POINTS
    assert np.nanmin(y_kept) == np.nanmin(y)
    assert np.nanmax(y_kept) == np.nanmax(y)
    rows = np.round(x_kept[known] / 0.1).astype(int)
    assert_allclose(y_kept[known], y[rows])
    assert (np.diff(rows) > 0).all()


def test_a_thinned_band_covers_every_pair_s_band() -> None:
    random = np.random.default_rng(1)
    n = 3 * MAX_LINE_POINTS
    t, middle = np.arange(n) * 1.0, random.standard_normal(n)
    x, low, high = band(t, middle - 1, middle + 1)
    assert len(x) <= 2 * N_BINS
    assert (np.interp(t, x, low) <= middle - 1 + 1e-9).mean() > 0.99  # between two bins it slopes
    assert low.min() == (middle - 1).min()
    assert high.max() == (middle + 1).max()


def test_pieces_are_what_lies_between_breaks() -> None:
    x = np.array([np.nan, 1, 2, np.nan, 3])
    assert [x[piece].tolist() for piece in pieces(x)] == [[1, 2], [3]]
    assert pieces(np.empty(0)) == []


def test_a_rotation_vector_is_followed_through_whole_turns_and_lost_pairs() -> None:
    axis = np.array([0.6, 0.0, 0.8])
    angle = np.linspace(10.0, 700.0, 200)
    turns = Rotation.from_rotvec(angle[:, None] * axis, degrees=True)
    followed = unwrap_rotation(turns.as_rotvec(degrees=True))
    assert_allclose(followed, angle[:, None] * axis, atol=1e-6)
    random = np.random.default_rng(2)
    vectors = Rotation.from_rotvec(random.standard_normal((60, 3)) * 2).as_rotvec(degrees=True)
    vectors[10:14] = np.nan
    followed = unwrap_rotation(vectors)
    seen = np.isfinite(vectors[:, 0])
    same = Rotation.from_rotvec(followed[seen], degrees=True).inv() * Rotation.from_rotvec(
        vectors[seen], degrees=True
    )
    assert_allclose(same.magnitude(), 0, atol=1e-9)
    assert np.isnan(followed[~seen]).all()


@pytest.mark.parametrize("first", [1.7e9, 20_262.0, 3.0, 0.0])
def test_times_are_shown_from_the_first_pair(first: float) -> None:
    t, label = time_axis(pd.DataFrame({"t_s": [np.nan, first, first + 1]}))
    assert_allclose(t, [np.nan, 0, 1])
    assert label == "since first pair [s]"


def test_a_missing_column_is_all_unknown_and_runs_gather_equal_neighbours() -> None:
    assert np.isnan(column(pd.DataFrame({"a": [1, 2]}), "b")).all()
    assert column(pd.DataFrame(), "b").size == 0
    t = np.arange(4.0)
    assert runs(["a", "a", "b", "a"], t) == [("a", 0, 1), ("b", 2, 2), ("a", 3, 3)]


def test_a_run_ends_where_pairs_are_missing() -> None:
    t = np.array([0.0, 0.1, 0.2, 0.5, 0.6])
    assert runs(["a"] * 5, t) == [("a", 0, 2), ("a", 3, 4)]
