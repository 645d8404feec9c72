"""What a calibration is worth: against laws, Monte Carlo through the cameras, and real pictures."""

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.testing import assert_allclose

import reports
from tests.bench.halves import SETS
from tests.support.reports import calibration as made
from verify.calibration.origin import ResultsOrigin
from verify.calibration.quality.advice import calibration_doubts, coverage_gaps
from verify.calibration.quality.coverage import BoardOrientation
from verify.calibration.quality.quality import (
    draw_rectified,
    judge_calibration,
    outlying_views,
    view_residuals,
)
from verify.calibration.quality.results import calibration_results
from verify.calibration.stereo.parameters import PARAMETER_KEYS
from verify.calibration.stereo.records import Calibration, rms
from verify.core.records import SIDES


def test_every_view_is_summed_up_and_a_bad_one_is_named() -> None:
    found = made.with_poor_view(made.calibration(), frame=4, camera=1)
    table = view_residuals(found.residuals)
    assert [(v.camera, v.frame) for v in table] == [(c, f) for c in (0, 1) for f in range(20)]
    assert [(v.camera, v.frame) for v in table if v.poor] == [(1, 4)]
    bad = table[24]
    own = found.residuals
    chosen = own.used & (own.camera == 1) & (own.frame == 4)
    assert bad.refused == 2
    assert bad.corners == chosen.sum()
    squares = np.sum(own.residual[chosen] ** 2, axis=1)
    assert bad.rms == pytest.approx(np.sqrt(squares.mean()))
    message = calibration_doubts(found, judge_calibration(found), {4: "left05.png and right05.png"})
    assert message[0].startswith("Pair 4 (left05.png and right05.png) hurts in the right camera")
    assert bad.largest == pytest.approx(np.sqrt(squares.max()))


def test_views_of_nothing_but_noise_do_not_stand_out() -> None:
    named = [
        v for seed in range(8) for v in view_residuals(made.calibration(seed).residuals) if v.poor
    ]
    assert not named


def test_few_views_cannot_outvote_each_other() -> None:
    assert not outlying_views(np.array([0.1, 0.1, 5.0])).any()
    assert outlying_views(np.array([0.1, 0.1, 0.1, 0.1, 5.0, np.nan])).tolist() == [
        False, False, False, False, True, False,
    ]  # fmt: skip


@pytest.mark.shared
@pytest.mark.slow
def test_the_two_bad_pictures_of_the_lifecam_are_named() -> None:
    lifecam = SETS["lifecam"]
    residuals = lifecam.calibrate(lifecam.pairs()).residuals
    assert rms(residuals.residual[residuals.frame < 14]) < 0.6
    # img6 and img7: the names are sorted as text
    assert [v.frame for v in view_residuals(residuals) if v.poor and v.frame < 14] == [10, 11]


def test_complete_coverage_gives_no_advice() -> None:
    found = made.calibration(count=60)
    quality = judge_calibration(found)
    assert coverage_gaps(found, quality) == ()
    assert calibration_doubts(found, quality) == ()


@pytest.mark.parametrize(
    ("tilt_deg", "kept", "words"),
    [
        (8.0, lambda _: True, r"never tilted about the horizontal axis by more than \d+°"),
        (8.0, lambda _: True, r"never tilted about the vertical axis by more than \d+°"),
        (35.0, lambda s: s.about_horizontal > 0, "horizontal axis with its lower edge nearer"),
        (35.0, lambda s: s.distance < 0.8, "^All boards stood between"),
    ],
)
def test_what_boards_never_did_is_advised(
    tilt_deg: float, kept: Callable[[BoardOrientation], bool], words: str
) -> None:
    found = made.calibration(count=60, tilt_deg=tilt_deg)
    quality = judge_calibration(found)
    orientations = tuple(s for s in quality.orientations if kept(s))
    gaps = coverage_gaps(found, replace(quality, orientations=orientations))
    assert [gap for gap in gaps if re.search(words, gap)]


@pytest.mark.parametrize(
    ("column", "row", "words"),
    [(2, 0, "upper right"), (0, 1, "left edge"), (1, 1, "middle"), (0, 2, "lower left")],
)
def test_a_part_of_the_image_without_corners_is_named(column: int, row: int, words: str) -> None:
    found = made.calibration(count=60)
    own = found.residuals
    at = np.floor((own.observed + 0.5) / [1280 / 3, 720 / 3])
    away = (own.camera == 0) & (at == [column, row]).all(axis=1)
    cleared = replace(found, residuals=replace(own, used=own.used & ~away))
    message = coverage_gaps(cleared, judge_calibration(cleared))
    assert f"No corner lies in the {words} of the left image: the lens is" in " ".join(message)


def test_corners_missing_at_an_edge_give_the_advice_to_reach_it() -> None:
    found = made.calibration(count=60)
    own = found.residuals
    away = (own.camera == 1) & (own.observed[:, 0] > 1000)
    cleared = replace(found, residuals=replace(own, used=own.used & ~away))
    message = coverage_gaps(cleared, judge_calibration(cleared))
    assert [
        s for s in message if re.search(r"near the right edge \(2\d % bare\) of the right image", s)
    ]


def test_squares_that_come_out_wrong_are_a_doubt() -> None:
    wrong = replace(made.calibration(), square_found=(0.0402, 0.00001, 0.00004))
    assert [s for s in calibration_doubts(wrong, judge_calibration(wrong)) if "40.200 mm" in s]
    loose = replace(wrong, board=replace(made.BOARD, square_standard_uncertainty=0.0001))
    assert not calibration_doubts(loose, judge_calibration(loose))


def test_squares_that_no_pair_shows_to_both_cameras_are_not_judged() -> None:
    unknown = replace(made.calibration(), square_found=(np.nan, np.nan, np.nan))
    assert not [s for s in calibration_doubts(unknown, judge_calibration(unknown)) if "quare" in s]
    square = calibration_results(unknown).summary["square"]
    names = ("found_mm", "standard_uncertainty_mm", "deviation_mm")
    assert [square[name] for name in names] == [None, None, None]


def test_a_calibration_without_a_covariance_or_with_other_readings_is_refused() -> None:
    found = made.calibration()
    with pytest.raises(ValueError, match="covariance"):
        judge_calibration(replace(found, rig=replace(found.rig, covariance=None)))
    with pytest.raises(ValueError, match="20 pairs"):
        judge_calibration(found, np.zeros((3, 2)))


def test_a_rectified_pair_has_its_corners_on_level_lines() -> None:
    found = made.calibration()
    whole = [f for f in found.frames if (found.residuals.frame == f).sum() == 2 * len(made.BOARD)]
    frame = int(whole[0])
    png = draw_rectified(found.rig, *made.pictures(found, frame))
    assert png == draw_rectified(found.rig, *made.pictures(found, frame))
    both = cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_COLOR)
    grey = both[:, :, 2]  # red: the level lines are darker there than white, lighter than black
    halves = grey[:, : grey.shape[1] // 2 - 2], grey[:, grey.shape[1] // 2 + 2 :]
    corners = []
    for half in halves:
        there, seen = cv2.findChessboardCornersSB(np.ascontiguousarray(half), (9, 7))
        assert there
        points = seen.reshape(-1, 2)
        corners.append(points if points[0, 0] < points[-1, 0] else points[::-1])
    assert_allclose(corners[0][:, 1], corners[1][:, 1], atol=1.5)  # px of a picture half as large


PLAIN = {"camera", "frame", "corner", "corners", "refused", "poor", "used", "kind", "name", "group",
         "parameter", "unit", "value", "standard_uncertainty", "state"}  # fmt: skip


def _results(found: Calibration) -> reports.Results:
    origin = ResultsOrigin("boards", inputs=made.INPUTS)
    return calibration_results(found, picture=made.pictures(found), origin=origin)


def test_results_come_back_are_the_same_each_time_and_every_column_has_a_unit(
    tmp_path: Path,
) -> None:
    first = _results(made.calibration())
    reports.write(first, tmp_path / "one")
    reports.write(_results(made.calibration()), tmp_path / "two")
    for path in sorted((tmp_path / "one").iterdir()):
        assert path.read_bytes() == (tmp_path / "two" / path.name).read_bytes()
    again = reports.read(tmp_path / "one")
    assert again.summary["kind"] == "calibration"
    assert again.tables.keys() == first.tables.keys()
    for table in first.tables.values():
        for name in table.columns:
            assert name in PLAIN or re.search(r"_(px|mm|deg)$", name), name


def test_every_parameter_of_the_model_is_listed_with_what_became_of_it() -> None:
    table = _results(made.calibration()).tables["parameters"]
    assert list(zip(table["camera"], table["parameter"], strict=True)) == [
        (side, key) for side in SIDES for key in PARAMETER_KEYS
    ]
    rows = table.set_index(["camera", "parameter"])
    assert rows.loc[("left", "fx_px"), "state"] == "found"
    assert rows.loc[("left", "fx_px"), "value"] == pytest.approx(1014.4, abs=1.0)
    assert rows.loc[("left", "mount_x_mm"), "state"] == "gauge"
    found = table["state"] == "found"
    assert (table["standard_uncertainty"] > 0).tolist() == found.tolist()
