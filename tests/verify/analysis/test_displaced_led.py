"""An LED that is not where marker.toml has it, in recorded pictures: it is named and left out."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from verify.analysis.session import analyse
from verify.calibration.kinematics.sessions import session_to_poses
from verify.core.records import no_progress
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
    assert pictures["contradict"]
    assert not (pictures["displaced_led"] or {}).get("left_out")
