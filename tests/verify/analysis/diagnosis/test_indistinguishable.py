"""Errors at the first or the last axis beside a base or LED body that is turned or shifted."""

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from reports import render_html
from reports.results import Results
from tests.support.simulated import InMemory, in_memory, marker_of, measured_at_spots, scene
from verify.analysis.session import analyse
from verify.core.records import Array, Measurement
from verify.measurement.systematics import stated_systematics
from verify.simulation.scenario import (
    MultiJoint,
    ScenarioClock,
    ScenarioEncoders,
    ScenarioFault,
    ScenarioRecording,
)

TURN_DEG = 0.4
SHIFT = 3e-3  # m
FIRST, LAST = (1, "base_turned", "the robot base"), (6, "led_body_turned", "the LED body")


def played(*fault: ScenarioFault) -> InMemory:
    return in_memory(
        scene(
            clock=ScenarioClock(), fault=[*fault], marker=marker_of("ABCD"),
            motion=MultiJoint(
                home_deg=[30.0, -62.0, 46.0, 8.0, -84.0, 24.0], amplitude_deg=[20.0] * 6
            ),
            recording=ScenarioRecording(pairs=40, rate_hz=10.0),
            encoders=ScenarioEncoders(noise_deg=0.002),
        )
    )  # fmt: skip


def analysed(session: InMemory) -> Results:
    """What is found by the session's rig and marker of the spots that the true ones show."""
    rng = np.random.default_rng(4)
    true = played()

    def measured(*_: Any) -> Iterator[Measurement]:
        systematics = stated_systematics(session.rig, session.marker, turning=False)
        stated = replace(true, rig=session.rig, marker=session.marker)
        yield from measured_at_spots(stated, systematics, rng)

    return analyse(session, chain=measured)


def stated_wrongly(part: str) -> InMemory:
    """Base or LED body stated as turned about the first or the last axis, or shifted along it."""
    session, along = played(), np.array([0.0, 0.0, SHIFT])
    if part == "led_body_shifted":
        return replace(session, marker=replace(session.marker, leds=session.marker.leds + along))
    if part == "base_shifted":
        moved = np.eye(4)
        moved[:3, 3] = along
        rig = replace(session.rig, rig_T_base=session.rig.rig_T_base @ moved)
        return replace(session, rig=rig)
    turn: Array = Rotation.from_euler("z", -TURN_DEG, degrees=True).as_matrix()
    if part == "led_body_turned":
        leds = session.marker.leds @ turn.T
        return replace(session, marker=replace(session.marker, leds=leds))
    turned = np.eye(4)
    turned[:3, :3] = turn.T
    rig = replace(session.rig, rig_T_base=session.rig.rig_T_base @ turned)
    return replace(session, rig=rig)


@pytest.mark.parametrize(("joint", "part", "name"), [FIRST, LAST])
def test_a_turn_about_the_axis_shows_as_the_joint_s_offset_and_is_named(
    joint: int, part: str, name: str
) -> None:
    offset = analysed(played(ScenarioFault(joint=joint, offset_deg=-TURN_DEG)))
    turned = analysed(stated_wrongly(part))
    (one,), (other,) = offset.summary["diagnosis"], turned.summary["diagnosis"]
    for cause in (one, other):
        assert (cause["kind"], cause["joint"], cause["same_as"]) == ("offset", joint, part)
    assert_allclose(one["value"], -TURN_DEG, atol=2 * one["expanded_uncertainty"])
    assert_allclose(abs(other["value"]), abs(one["value"]), atol=one["expanded_uncertainty"])
    assert f"({name}, turned as much about this axis, would show the same)" in render_html(turned)


def test_of_a_joint_between_nothing_shows_the_same() -> None:
    (cause,) = analysed(played(ScenarioFault(joint=3, offset_deg=TURN_DEG))).summary["diagnosis"]
    assert (cause["kind"], cause["joint"]) == ("offset", 3)
    assert "same_as" not in cause


@pytest.mark.parametrize(
    ("part", "parameter", "words"),
    [
        ("base_shifted", "d1", "the robot base, shifted as much along this axis, would show"),
        ("led_body_shifted", "d6", "the LED body, shifted as much, would show"),
    ],
)
def test_a_shift_along_the_axis_shows_as_the_link_s_length_and_is_named(
    part: str, parameter: str, words: str
) -> None:
    results = analysed(stated_wrongly(part))
    (cause,) = results.summary["diagnosis"]
    assert (cause["kind"], cause["parameter"], cause["same_as"]) == ("dh", parameter, part)
    assert_allclose(abs(cause["value"]), 1e3 * SHIFT, atol=2 * cause["expanded_uncertainty"])
    assert words in render_html(results)
