"""LEDs that are not where marker.toml has them, in recorded pictures.

One is named and left out; several are taken where the pictures show them.
"""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from verify.analysis.session import analyse
from verify.calibration.kinematics.sessions import session_to_poses
from verify.core.records import Array, no_progress
from verify.errors import InputError
from verify.io.session.session import Session, open_session

SAMPLES = Path(__file__).parents[3] / "sample_sessions"
FAULT = {"multi_joint_fault_6r": ["offset"], "multi_joint_rv_3sd": []}  # of one joint, the second
DISPLACED = (("A", [0.1, -0.2, 0.45]), ("B", [0.0, 0.0, -2.0]), ("D", [1.3, -1.4, 0.6]))  # mm


def with_leds_displaced(session: Session, by_mm: dict[str, list[float]]) -> Session:
    """The session with LEDs seen `by_mm` from their places in marker.toml."""
    marker, leds = session.marker, session.marker.leds.copy()
    for name, displacement in by_mm.items():
        leds[marker.names.index(name)] -= np.array(displacement) * 1e-3
    return replace(session, marker=replace(marker, leds=leds))


def told_of_led(summary: dict[str, Any], name: str) -> list[str]:
    return [w for w in summary["warnings"] if w.startswith(f"LED {name} is seen ")]


@pytest.mark.parametrize("sample", FAULT)
@pytest.mark.parametrize(("name", "by_mm"), DISPLACED, ids=[name for name, _ in DISPLACED])
def test_a_displaced_led_is_left_out_and_no_joint_is_blamed(
    sample: str, name: str, by_mm: list[float]
) -> None:
    session = open_session(SAMPLES / sample)
    sound = analyse(session).summary
    summary = analyse(with_leds_displaced(session, {name: by_mm})).summary
    assert [j["verdict"] for j in summary["joints"]] == [j["verdict"] for j in sound["joints"]]
    assert [cause["kind"] for cause in summary["diagnosis"]] == FAULT[sample]
    assert summary["pairs"]["measured"] == sound["pairs"]["measured"]
    for one, other in zip(summary["joints"], sound["joints"], strict=True):
        off = abs(one["mean_error_deg"] - other["mean_error_deg"])
        assert off < one["expanded_uncertainty_deg"] + other["expanded_uncertainty_deg"]
    led = summary["pictures"]["displaced_led"]
    assert (led["name"], led["left_out"], summary["pictures"]["contradict"]) == (name, True, False)
    # the places themselves are drawn, with 0.02 mm
    assert led["displacement_mm"] == pytest.approx(by_mm, abs=0.08)
    assert "left out" in told_of_led(summary, name)[0]


def test_parameters_are_identified_without_a_displaced_led_too() -> None:
    session = open_session(SAMPLES / "multi_joint_fault_6r")
    sound = session_to_poses(session, no_progress)
    name, by_mm = DISPLACED[1]
    found = session_to_poses(with_leds_displaced(session, {name: by_mm}), no_progress)
    assert len(found.session.marker) == len(session.marker) - 1
    assert found.session.warnings[-1].startswith(f"LED {name} is seen ")
    off = found.comparison.xi - sound.comparison.xi
    assert np.abs(off[:, 3:]).max() < np.deg2rad(0.1)


def test_of_two_displaced_leds_none_is_left_out() -> None:
    session = open_session(SAMPLES / "multi_joint_rv_3sd")
    both = with_leds_displaced(session, {"A": [0.0, 0.0, 1.0], "B": [0.0, 1.0, -1.0]})
    pictures = analyse(both).summary["pictures"]
    assert pictures["led_shifts"]
    assert not (pictures["displaced_led"] or {}).get("left_out")


def placed_by_hand(session: Session, seed: int, sigma_mm: float, stated: bool = False) -> Session:
    """The session with a marker.toml whose every place was measured with that uncertainty."""
    rng, marker = np.random.default_rng(seed), session.marker
    leds = marker.leds + rng.normal(0, sigma_mm * 1e-3, marker.leds.shape)
    u = sigma_mm * 1e-3 if stated else marker.led_standard_uncertainty
    return replace(session, marker=replace(marker, leds=leds, led_standard_uncertainty=u))


def distances(leds: Array) -> Array:
    return np.linalg.norm(leds[:, None] - leds[None], axis=2)


@pytest.mark.parametrize("sample", FAULT)
@pytest.mark.parametrize("sigma_mm", [0.2, 0.5, 1.0])
@pytest.mark.parametrize(("seed", "stated"), [(21, False), (22, False), (23, True)])
def test_leds_placed_by_hand_are_taken_where_the_pictures_show_them(
    sample: str, sigma_mm: float, seed: int, stated: bool
) -> None:
    session = open_session(SAMPLES / sample)
    sound = analyse(session)
    wrong = placed_by_hand(session, seed, sigma_mm, stated)
    results = analyse(wrong)
    summary = results.summary
    assert summary["pairs"]["measured"] == sound.summary["pairs"]["measured"]
    assert not summary["pictures"]["contradict"]
    assert [cause["kind"] for cause in summary["diagnosis"]] == FAULT[sample]
    assert any("not where marker.toml puts them" in warning for warning in summary["warnings"])
    # the pictures know how far the LEDs are from each other; their places are drawn, with 0.02 mm
    used = np.array([[led[f"{a}_mm"] for a in "xyz"] for led in results.setup["marker"]["leds"]])
    true = session.marker.leds * 1e3
    assert np.abs(distances(used) - distances(true)).max() < 0.1
    shift = np.array(summary["pictures"]["led_shifts"]["shift_mm"])
    assert used == pytest.approx(wrong.marker.leds * 1e3 + shift, abs=1e-9)
    # the last joint turns with the body, whose place nothing shows; all others are as before
    for one, other in zip(summary["joints"], sound.summary["joints"], strict=True):
        off = abs(one["mean_error_deg"] - other["mean_error_deg"])
        assert off < one["expanded_uncertainty_deg"] + other["expanded_uncertainty_deg"]
    assert max(j["expanded_uncertainty_deg"] for j in summary["joints"][:-1]) < 0.1
    assert summary["joints"][-1]["expanded_uncertainty_deg"] > 0.25 * sigma_mm


@pytest.mark.parametrize("sample", FAULT)
@pytest.mark.parametrize("seed", [1000, 1001, 1004, 1013])
def test_a_body_that_stands_degrees_off_accuses_no_joint(sample: str, seed: int) -> None:
    """Places that are off by 2 mm turn the body by degrees, which first order does not tell."""
    session = open_session(SAMPLES / sample)
    summary = analyse(placed_by_hand(session, seed, 2.0)).summary
    assert summary["pictures"]["led_shifts"]
    assert [cause["joint"] for cause in summary["diagnosis"] if cause["joint"]] in ([], [2])
    for joint in summary["joints"][:-1]:
        fault = 0.35 * (sample == "multi_joint_fault_6r" and joint["joint"] == 2)
        assert abs(joint["mean_error_deg"] - fault) < 1.5 * joint["expanded_uncertainty_deg"]


def test_places_are_sought_where_the_few_pairs_that_fit_agree_with_the_files() -> None:
    wrong = placed_by_hand(open_session(SAMPLES / "multi_joint_rv_3sd"), 1006, 2.0)
    summary = analyse(wrong).summary  # of 60 pairs 11 fit a pose by marker.toml's places
    assert summary["pairs"]["measured"] == 60
    assert summary["pictures"]["led_shifts"]
    assert summary["diagnosis"] == []


def test_two_leds_that_are_off_by_centimetres_are_found_too() -> None:
    session = open_session(SAMPLES / "multi_joint_fault_6r")
    wrong = with_leds_displaced(session, {"B": [-10.0, 0.0, 0.0], "C": [0.0, -5.0, 0.0]})
    summary = analyse(wrong).summary
    assert summary["pairs"]["measured"] == 60
    assert [cause["kind"] for cause in summary["diagnosis"]] == ["offset"]
    assert summary["pictures"]["displaced_led"] is None  # C was, by one stray pair, U = 0.00 mm


def test_parameters_are_identified_with_leds_placed_by_hand_too() -> None:
    session = open_session(SAMPLES / "multi_joint_fault_6r")
    found = session_to_poses(placed_by_hand(session, 21, 0.5), no_progress)
    used, true = found.session.marker.leds, session.marker.leds
    assert np.abs(distances(used) - distances(true)).max() < 1e-4


def test_three_leds_placed_by_hand_are_taken_where_the_pictures_show_them() -> None:
    session = open_session(SAMPLES / "multi_joint_fault_6r")
    three = replace(session, marker=session.marker.without("B"))
    summary = analyse(placed_by_hand(three, 3, 0.5)).summary
    assert summary["pictures"]["led_shifts"]
    assert [cause["kind"] for cause in summary["diagnosis"]] == ["offset"]


@pytest.mark.parametrize("sample", FAULT)
@pytest.mark.parametrize("change", ["focal", "principal point", "pan zero", "body scale"])
def test_what_the_rig_does_is_not_taken_for_places_of_leds(sample: str, change: str) -> None:
    session = open_session(SAMPLES / sample)
    rig, marker = session.rig, session.marker
    matrix = rig.right.matrix.copy()
    right = rig.right
    if change == "focal":
        matrix[[0, 1], [0, 1]] *= 1.01
        right = replace(right, matrix=matrix)
    elif change == "principal point":
        matrix[1, 2] += 3.0
        right = replace(right, matrix=matrix)
    elif change == "pan zero":
        right = replace(right, pan_zero=right.pan_zero + np.deg2rad(0.2))
    else:
        marker = replace(marker, leds=marker.leds * 1.01)
    wrong = replace(session, rig=replace(rig, right=right), marker=marker)
    try:
        pictures = analyse(wrong).summary["pictures"]
    except InputError:
        return
    assert pictures is None or pictures["led_shifts"] is None
