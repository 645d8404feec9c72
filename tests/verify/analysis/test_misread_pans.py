"""Pan readings with a usual mistake, in a session whose bases follow the arm."""

import re
from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from tests.support.simulated import InMemory, in_memory, marker_of, scene
from verify.analysis.measured import measure_pictures
from verify.analysis.mistakes import refuse_misread_pans
from verify.analysis.results.warnings import lost_pairs_warning
from verify.analysis.session import analyse
from verify.core.records import Array, no_progress
from verify.errors import InputError
from verify.measurement.chain import measure
from verify.simulation.scenario import ScenarioCamera, ScenarioRecording, ScenarioRig

LENS = ScenarioCamera(focal_px=(505.0, 505.0), principal_point_px=(319.5, 179.5))
RIG = ScenarioRig(image_size=(640, 360), bases="follow", left=LENS, right=LENS)


@cache
def recorded() -> InMemory:
    return in_memory(
        scene(rig=RIG, marker=marker_of("ABCD"), recording=ScenarioRecording(pairs=14, rate_hz=8.0))
    )


def spoiled(change: Callable[[Array, Array], tuple[Array, Array]]) -> InMemory:
    """The session with other pan readings, rad."""
    session = recorded()
    left, right = change(session.frames.pan_left, session.frames.pan_right)
    return replace(session, frames=replace(session.frames, pan_left=left, pan_right=right))


def late(pan: Array) -> Array:
    """Each pair has the reading of the one before."""
    return np.append(pan[0], pan[:-1])


@pytest.mark.parametrize(
    ("change", "found", "remedy"),
    [
        (lambda left, right: (-left, right), "pan_left_deg reversed", "by -1"),
        (lambda left, right: (right, left), "pan_right_deg exchanged", "Exchange"),
        (lambda left, right: (left, late(right)), "pan_right_deg a row too late", "up by one row"),
        (lambda left, right: (late(left), late(right)), "deg a row too late", "up by one row"),
        (lambda left, right: (np.deg2rad(left), np.deg2rad(right)), "in radians", "by 180/π"),
    ],
)  # fmt: skip
def test_a_usual_mistake_in_pan_readings_is_named_with_its_columns(
    change: Callable[[Array, Array], tuple[Array, Array]], found: str, remedy: str
) -> None:
    with pytest.raises(InputError) as caught:
        analyse(spoiled(change))
    text = str(caught.value)
    assert re.match(r"\S*frames\.csv: the pictures do not agree with the pan readings; ", text)
    assert found in text
    assert remedy in text


def test_a_base_whose_zero_is_off_is_named_with_its_turn() -> None:
    for moved, said in (
        ((3.0, 0.0), r"frames\.csv: .* pan_left_deg about 3\.0° too large fits: 14 of 14"),
        (
            (0.0, -12.0),
            r"frames\.csv: .* pan_right_deg about 12\.0° too small fits.*right\.pan_zero",
        ),
    ):
        off = np.deg2rad(moved)
        with pytest.raises(InputError, match=said):
            analyse(spoiled(lambda left, right, off=off: (left + off[0], right + off[1])))


def test_lengths_off_by_some_per_cent_are_not_taken_for_a_turned_base() -> None:
    session = recorded()
    cameras = [
        replace(c, pan_center=0.98 * c.pan_center) for c in (session.rig.left, session.rig.right)
    ]
    nearer = replace(session.rig, left=cameras[0], right=cameras[1])
    with pytest.raises(InputError) as caught:
        analyse(replace(session, rig=nearer))
    assert "too large" not in str(caught.value)
    assert "too small" not in str(caught.value)


@pytest.mark.parametrize(
    ("unit", "size"), [("centimetres", 10.0), ("inches", 25.4), ("metres", 1e3)]
)
def test_places_in_another_unit_are_named(unit: str, size: float) -> None:
    session = recorded()
    rig, marker = session.rig, session.marker
    cameras = [replace(c, pan_center=c.pan_center / size) for c in (rig.left, rig.right)]
    with pytest.raises(
        InputError, match=rf"rig\.toml: .*pan_center_mm in {unit} fits.* by {size:g}\."
    ):
        analyse(replace(session, rig=replace(rig, left=cameras[0], right=cameras[1])))
    leds = replace(marker, leds=marker.leds / size)
    with pytest.raises(
        InputError, match=rf"marker\.toml: .*position_mm of the LEDs in {unit} fits"
    ):
        analyse(replace(session, marker=leds))


def test_times_of_the_cameras_that_are_exchanged_are_named(monkeypatch: pytest.MonkeyPatch) -> None:
    recording = ScenarioRecording(pairs=14, rate_hz=8.0, skew_s=0.006)
    session, pairs = in_memory(scene(marker=marker_of("ABCD"), recording=recording)), InMemory.pairs
    frames = replace(session.frames, t_left=session.frames.t_right, t_right=session.frames.t_left)
    monkeypatch.setattr(
        InMemory, "pairs", lambda self: (
            replace(pair, t_left=pair.t_right, t_right=pair.t_left) for pair in pairs(self)
        ),
    )  # fmt: skip
    with pytest.raises(InputError, match=r"frames\.csv: .*t_left_s and t_right_s exchanged fits"):
        analyse(replace(session, frames=frames))


def test_one_film_for_both_cameras_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    pairs = InMemory.pairs
    monkeypatch.setattr(
        InMemory, "pairs", lambda self: (replace(pair, right=pair.left) for pair in pairs(self))
    )
    with pytest.raises(InputError, match=r"right\.mkv: its pictures are those of the left camera"):
        analyse(recorded())


def test_right_pan_readings_are_not_refused_where_pairs_are_lost() -> None:
    session = recorded()
    measurements = measure_pictures(session, no_progress, measure).measurements
    assert {m.status for m in measurements} == {"measured"}
    hidden = [replace(m, status="too_few_leds") if m.frame % 2 else m for m in measurements]
    refuse_misread_pans(session, hidden)
    assert "lit and in view" in (lost_pairs_warning(hidden) or "")


def test_pictures_are_read_once_for_all_mistakes(monkeypatch: pytest.MonkeyPatch) -> None:
    session, read = recorded(), []
    measurements = measure_pictures(session, no_progress, measure).measurements
    pairs = InMemory.pairs
    monkeypatch.setattr(InMemory, "pairs", lambda self: read.append(1) or pairs(self))
    lost = [replace(m, status="outlier") if m.frame % 2 else m for m in measurements]
    refuse_misread_pans(session, lost)
    assert len(read) == 1


def test_readings_that_stand_while_pairs_are_lost_are_named() -> None:
    warnings = analyse(spoiled(lambda left, right: (left, 0 * right + right[0]))).summary[
        "warnings"
    ]
    assert any("no two readings of pan_right_deg differ" in one for one in warnings)
