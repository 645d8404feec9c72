"""A base or LED body far from where the files have it: the joints are judged as if it were not."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from verify.analysis.session import analyse
from verify.core.records import Array, rigid_transform
from verify.io.session.session import Session, open_session

SAMPLES = Path(__file__).parents[3] / "sample_sessions"
FAULTY, HEALTHY = "multi_joint_fault_6r", "multi_joint_rv_3sd"
OFFSET = 0.35  # deg, of joint 2 of the faulty one, as its scenario says


def motion(seed: int, shift_mm: float, turn_deg: float) -> Array:
    rng = np.random.default_rng(seed)
    along, about = (v / np.linalg.norm(v) for v in rng.normal(size=(2, 3)))
    turn = Rotation.from_rotvec(np.deg2rad(turn_deg) * about).as_matrix()
    return rigid_transform(turn, 1e-3 * shift_mm * along)


def with_base_elsewhere(session: Session, moved: Array) -> Session:
    return replace(session, rig=replace(session.rig, rig_T_base=session.rig.rig_T_base @ moved))


def with_body_elsewhere(session: Session, moved: Array) -> Session:
    leds = session.marker.leds @ moved[:3, :3].T + moved[:3, 3]
    return replace(session, marker=replace(session.marker, leds=leds))


def judged(session: Session) -> tuple[str, list[tuple[str, int | None]], list[dict[str, Any]]]:
    summary = analyse(session).summary
    causes = summary["diagnosis"]
    verdicts = " ".join(joint["verdict"] for joint in summary["joints"])
    return verdicts, [(cause["kind"], cause["joint"]) for cause in causes], causes


@pytest.mark.parametrize("seed", [1, 2])
@pytest.mark.parametrize(("shift", "turn"), [(5.0, 0.0), (20.0, 0.0), (0.0, 3.0)])
def test_a_base_elsewhere_is_the_cause_beside_a_joints_own_fault(
    seed: int, shift: float, turn: float
) -> None:
    """Its arm stands near a singularity: the wrong base looks like joints that are off by 30°."""
    session = with_base_elsewhere(open_session(SAMPLES / FAULTY), motion(seed, shift, turn))
    verdicts, kinds, causes = judged(session)
    assert kinds == [("base_moved", None), ("offset", 2)]
    base, offset = causes
    # 0.35° and 3° about other axes turn each other by 0.2 mm, over the arm's length
    assert base["value"] == pytest.approx(shift, abs=base["expanded_uncertainty"] + 0.1)
    assert base["turn_deg"] == pytest.approx(turn, abs=0.02)
    assert offset["value"] == pytest.approx(OFFSET, abs=offset["expanded_uncertainty"])
    # a turn about the first axis looks like joint 1, whoever made it
    assert verdicts == "undecided nonconform conform conform conform conform"


@pytest.mark.parametrize(("shift", "turn"), [(10.0, 0.0), (20.0, 2.0), (0.0, 3.0)])
def test_of_a_base_elsewhere_no_healthy_joint_is_accused(shift: float, turn: float) -> None:
    session = with_base_elsewhere(open_session(SAMPLES / HEALTHY), motion(2, shift, turn))
    verdicts, kinds, (base,) = judged(session)
    assert kinds == [("base_moved", None)]
    assert base["value"] == pytest.approx(shift, abs=0.3)  # and what is drawn of its doubt
    assert base["turn_deg"] == pytest.approx(turn, abs=0.03)
    assert verdicts.split()[1:] == ["conform"] * 5


@pytest.mark.parametrize(("shift", "turn"), [(20.0, 0.0), (0.0, 4.0), (10.0, 3.0)])
def test_of_a_body_elsewhere_no_healthy_joint_is_accused(shift: float, turn: float) -> None:
    session = with_body_elsewhere(open_session(SAMPLES / HEALTHY), motion(3, shift, turn))
    verdicts, kinds, (body,) = judged(session)
    assert kinds == [("led_body_slipped", None)]
    assert body["value"] == pytest.approx(shift, abs=0.2)
    assert body["turn_deg"] == pytest.approx(turn, abs=0.03)
    assert verdicts.split()[:5] == ["conform"] * 5


@pytest.mark.parametrize(("shift", "turn"), [(20.0, 0.0), (0.0, 4.0), (10.0, 2.0)])
def test_a_body_elsewhere_is_told_beside_a_joints_fault_with_the_clock(
    shift: float, turn: float
) -> None:
    """No clock is stated: the motion shows it, and only without the body's own."""
    session = with_body_elsewhere(open_session(SAMPLES / FAULTY), motion(4, shift, turn))
    verdicts, kinds, (body, offset) = judged(session)
    assert kinds == [("led_body_slipped", None), ("offset", 2)]
    assert body["value"] == pytest.approx(shift, abs=0.2)
    assert body["turn_deg"] == pytest.approx(turn, abs=0.03)
    assert offset["value"] == pytest.approx(OFFSET, abs=offset["expanded_uncertainty"])
    assert verdicts.split()[1:5] == ["nonconform", "conform", "conform", "conform"]


@pytest.mark.parametrize(
    ("seed", "shift", "turn"),
    [(1, 5.0, 1.0), (2, 5.0, 1.0), (3, 5.0, 1.0), (2, 10.0, 2.0), (3, 10.0, 2.0)],
)
def test_base_and_body_elsewhere_are_both_told(seed: int, shift: float, turn: float) -> None:
    session = with_base_elsewhere(open_session(SAMPLES / FAULTY), motion(seed, shift, turn))
    session = with_body_elsewhere(session, motion(seed + 10, shift, turn))
    verdicts, kinds, causes = judged(session)
    assert sorted(kinds[:2]) == [("base_moved", None), ("led_body_slipped", None)]
    assert kinds[2:] == [("offset", 2)]
    for one in causes[:2]:  # where it turns about the first axis, joint 1 takes a share
        assert one["value"] == pytest.approx(shift, abs=one["expanded_uncertainty"] + 0.3)
    assert causes[2]["value"] == pytest.approx(OFFSET, abs=causes[2]["expanded_uncertainty"])
    assert verdicts.split()[2:5] == ["conform"] * 3


def test_a_base_elsewhere_is_not_taken_for_a_body_that_is_farther_off() -> None:
    """A turn of 4° of the base looks most like a body that is turned and shifted by 46 mm."""
    session = replace(open_session(SAMPLES / HEALTHY), clock=None)
    _, kinds, (base,) = judged(with_base_elsewhere(session, motion(0, 0.0, 4.0)))
    assert kinds == [("base_moved", None)]
    assert base["turn_deg"] == pytest.approx(4.0, abs=0.05)


@pytest.mark.parametrize("joint", [1, 2, 3, 4, 5])
@pytest.mark.parametrize("size", [1.0, 4.0])
def test_a_joint_that_steps_accuses_no_other(joint: int, size: float) -> None:
    """Near a singularity an offset that is off by a degree where it is linearised is another's."""
    session = open_session(SAMPLES / FAULTY)
    encoders, times = session.encoders, session.frames.t_left
    q = encoders.q.copy()
    # between two pairs, on the readings' clock, which is 0.085 s behind
    q[encoders.t > (times[29] + times[30]) / 2 - 0.085, joint - 1] += np.deg2rad(size)
    stepped = replace(session, encoders=replace(encoders, q=q))
    verdicts, kinds, causes = judged(stepped)
    assert set(kinds) == {("step", joint), ("offset", 2)}
    for cause in causes:
        true = size if cause["kind"] == "step" else OFFSET
        assert cause["value"] == pytest.approx(true, abs=cause["expanded_uncertainty"] + 0.002)
    others = {1, 3, 4, 5} - {joint}
    assert all(verdicts.split()[other - 1] != "nonconform" for other in others)


@pytest.mark.parametrize("along", [[3.0, 0.0, 0.0], [0.0, 3.0, 0.0], [-2.0, 0.0, 0.0]])
def test_where_the_motion_leaves_a_shift_open_the_base_is_no_farther_off(
    along: list[float],
) -> None:
    """Three joints in one plane do with any base there what one base does."""
    session = open_session(SAMPLES / "quarter_circle_6r")
    moved = rigid_transform(np.eye(3), 1e-3 * session.rig.rig_T_base[:3, :3].T @ np.array(along))
    verdicts, kinds, (base,) = judged(with_base_elsewhere(session, moved))
    assert kinds == [("base_moved", None)]
    assert base["value"] == pytest.approx(np.linalg.norm(along), abs=base["expanded_uncertainty"])
    assert "nonconform" not in verdicts
