"""The report of an interim check."""

import numpy as np

from reports.document.blocks import collect_figures
from tests.support.reports.page import Page, document_of, html_of, made_of


def test_the_verdict_is_the_check_s_and_names_what_is_off() -> None:
    good, bad = ("".join(Page(html_of(name)).text) for name in ("held", "not_held"))
    assert "The calibration holds" in good
    assert "Every figure lies within its uncertainty" in good
    assert "The calibration does not hold" in bad
    assert "Scale of known lengths is off by more than the uncertainty explains" in bad


def test_each_length_has_its_error_and_uncertainty() -> None:
    lengths = made_of("not_held").table("lengths")
    assert (lengths["error_mm"] < 0).all()  # all too short, as the yaw makes them
    np.testing.assert_allclose(
        lengths["measured_mm"] - lengths["known_mm"], lengths["error_mm"], atol=1e-12
    )
    assert (lengths["standard_uncertainty_mm"] > 0).all()


def test_one_pair_of_a_board_shows_its_square_and_no_strips() -> None:
    assert "over_pairs" not in collect_figures(document_of("board"))
    assert "Square as measured" in html_of("board")
