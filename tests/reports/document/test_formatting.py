import math
import re

import numpy as np
import pytest

from reports.document.formatting import (
    DASH,
    count,
    decimals_of,
    exact_number,
    join_words,
    joint_names,
    lookup_label,
    number,
    percent,
    probability,
    quantity,
    significant,
    with_uncertainty,
)
from reports.session import phrases

UNKNOWN = [None, math.nan, math.inf, "0.4", True, np.nan]


@pytest.mark.parametrize("value", UNKNOWN)
def test_what_is_not_a_finite_number_is_a_dash_in_every_form(value: object) -> None:
    forms = [number, significant, probability, percent, count, exact_number]
    assert [form(value) for form in forms] == [DASH] * len(forms)
    assert with_uncertainty(value, 0.1) == DASH
    assert quantity(value, "mm") == DASH


@pytest.mark.parametrize(
    ("value", "uncertainty", "text"),
    [
        (0.4, 0.015, "+0.400 ± 0.015"),
        (-0.4, 0.015, "−0.400 ± 0.015"),
        (0.13704, 0.00042, "+0.13704 ± 0.00042"),
        (12.34, 3.0, "+12.3 ± 3.0"),
        (0.1, 0.0996, "+0.10 ± 0.10"),  # 0.0996 rounds up to 0.10, two digits still
        (0.4, None, "+0.400"),
        (0.4, 0.0, "+0.400"),  # never ± 0
        (-1e-9, 0.01, "0.000 ± 0.010"),  # no sign before what is shown as nothing
    ],
)
def test_a_value_is_rounded_with_its_uncertainty_to_two_digits_of_it(
    value: float, uncertainty: float | None, text: str
) -> None:
    assert with_uncertainty(value, uncertainty) == text


def test_units_follow_as_the_si_brochure_sets_them_and_labels_as_they_are() -> None:
    assert with_uncertainty(0.4, 0.015, "°") == "+0.400° ± 0.015°"
    assert with_uncertainty(1.2, 0.1, "mm", signed=False) == "1.20 ± 0.10 mm"
    assert quantity(0.05, "°") == "0.050°"
    assert lookup_label(phrases.STATUSES, "lens_cap_on") == "lens cap on"
    assert lookup_label(phrases.STATUSES, None) == "–"


@pytest.mark.parametrize("uncertainty", [1e-12, 1e9, 0.0, None])
def test_decimals_are_limited_for_any_uncertainty(uncertainty: float | None) -> None:
    assert 0 <= decimals_of(uncertainty) <= 7


@pytest.mark.parametrize(
    ("value", "text"),
    [(0.0, "0 %"), (0.02, "2.0 %"), (0.41, "41 %"), (0.998, "99.8 %"), (0.9999, "> 99.9 %"),
     (1.0, "100 %")],
)  # fmt: skip
def test_a_share_is_never_rounded_up_to_all_or_down_to_nothing(value: float, text: str) -> None:
    assert percent(value) == text


@pytest.mark.parametrize("value", [-0.0, -1e-12, -0.0004])
def test_nothing_is_shown_with_a_sign(value: float) -> None:
    shown = [
        number(value), number(value, 3, signed=True), significant(round(value, 3)), count(value),
        with_uncertainty(value, 0.01, "°"), exact_number(round(value, 3)), percent(value / 100),
    ]  # fmt: skip
    assert not [text for text in shown if re.search(r"[-+−]0*[.]?0*(?![.0-9])", text)]


def test_a_probability_is_never_rounded_to_certainty_and_a_tolerance_not_at_all() -> None:
    probabilities = [probability(v) for v in (0.99999, 0.0, 0.95)]
    assert probabilities == ["> 0.999", "< 0.001", "0.950"]
    assert [exact_number(v) for v in (0.2, 0.125, 0.015, 1.0)] == ["0.2", "0.125", "0.015", "1"]


def test_joints_are_named_as_a_sentence_does() -> None:
    assert joint_names([3]) == "joint 3"
    assert joint_names([1, 2, 6], capital=True) == "Joints 1, 2 and 6"
    assert join_words([]) == ""
