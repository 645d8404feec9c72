"""Every word that a grab can say has its German; reasons are the program's own, not copies."""

import dataclasses
from typing import Any

import numpy as np
import pytest

from reports import html
from reports.grab import document
from reports.language_file import language
from reports.results import Results
from tests.reports import made_grab
from tests.verify.grab.planned_cell import cap, home, setup
from verify.devices.melfa_lines import ERRORS, RunState
from verify.grab.approach import Line, along
from verify.grab.branches import branch_name
from verify.grab.colour import NAMED_HUES_DEG
from verify.grab.gripper_line import EXCEPTIONS, RefusedError
from verify.grab.gripper_registers import FAULTS, fault_words
from verify.grab.hand_off import HandOff, LedSight, agreed
from verify.grab.limits import Motion, violation
from verify.grab.loop_closed import GOES_ON, said_of
from verify.grab.melfa_motion_release import GivingBack
from verify.grab.melfa_motion_words import refused, standing_alarm
from verify.grab.plan import Planner, line, plan
from verify.grab.plan_follow import Hover
from verify.grab.plan_margin import Refusal
from verify.grab.states import State
from verify.grab.states_machine import Machine
from verify.grab.states_watch import Observation, Watchdog
from verify.grab.trajectory_follow import Follower

GERMAN = language("de")
PLACES: tuple[dict[str, Any], ...] = (  # of objects that are refused
    {"width": 0.12},
    {"width": np.nan},
    {"position": np.full(3, np.nan)},
    {"position": np.array([0.6, 0.0, 0.03])},
    {"position": np.array([0.45, 0.0, 0.002])},
    {"length": 0.2},
    {"covariance": np.eye(3) * 0.02**2},
    {"covariance": np.diag([0, 0, 0.009]) ** 2},
    {"position": np.array([0.34, 0.0, 0.03])},
)


@pytest.fixture(scope="module")
def cell(tmp_path_factory: pytest.TempPathFactory) -> Planner:
    return setup(tmp_path_factory.mktemp("cell"))


def english(results: Results) -> list[str]:
    """What stays English, but for the names in it."""
    return [text for text in GERMAN.missing(document(results)) if text != "session"]


def untold(reasons: list[str]) -> list[str]:
    return english(made_grab.results({}, made_grab.reasons(reasons)))


@pytest.mark.parametrize("state", State)
def test_each_end_and_each_passage(state: State) -> None:
    summary = {"state": state.value, "reason": "the fingers met nothing"}
    assert english(made_grab.results(summary)) == []


def test_targets_by_colour_by_box_and_by_the_page() -> None:
    targets = [f"{colour} object" for colour in NAMED_HUES_DEG]
    targets += ["object in the box 3,4,50,60", "object selected on the page, left 3,4,50,60"]
    for target in targets:
        assert english(made_grab.results({"target": target, "cell": "simulated"})) == []
        told = GERMAN.document(document(made_grab.results({"target": target, "cell": "north"})))
        assert told.subtitle.endswith(", Zelle north")


def test_an_empty_grab_and_one_that_found_nothing() -> None:
    for state in ("searching", "idle"):
        assert english(Results({"kind": "grab", "state": state}, {}, {})) == []


def test_plans_and_refusals(cell: Planner) -> None:
    for changes in PLACES:
        found = plan(cell, cap(**changes), home(cell))
        assert isinstance(found, Refusal), changes
        rejected = [{"branch": name, "reason": said} for name, said in found.branches]
        told = {"kind": found.kind, "reason": found.reason, "rejected": rejected}
        assert english(made_grab.results({"refusal": told, "plan": None})) == []
    good = plan(cell, cap(), home(cell))
    assert not isinstance(good, Refusal)
    told_plan = made_grab.plan(good.rejected)
    for execute in (True, False):
        assert english(made_grab.results({"plan": told_plan, "execute": execute})) == []


def test_whatever_stands_in_the_way(cell: Planner) -> None:
    names, q = cell.workspace.names, home(cell)
    reasons = []
    for place in range(len(names)):
        margins = np.ones(len(names))
        margins[place] = -0.01
        reasons.append(cell.workspace.trouble(margins))
    fast = np.full(6, 50.0)
    motions = (Motion(fast, 0 * q, 0 * q), Motion(q, fast, 0 * q), Motion(q, 0 * q, fast))
    reasons += [violation(cell.limits, motion) for motion in motions]
    shift = np.array([0.0, 0.0, -0.4])
    for told in (line(cell, 0, q, 2 * shift, "on the line down"), line(cell, 0, q, 4 * shift)):
        assert isinstance(told, str)
        reasons.append(told)
    folded = q * [1, 1, 1, 1, 0, 1] + 1e-4  # the wrist next to its singularity
    pose = cell.workspace.grip(folded)
    bent = along(cell.arm, Line(pose, np.array([0.0, 0.1, 0.0])), 0, folded)
    assert isinstance(bent, str)
    far = Hover(cell).goal(np.array([0.9, 0.0, 0.03]), np.zeros(3), q)
    assert isinstance(far, Refusal)
    with pytest.raises(ValueError, match="begin") as problem:
        Follower(cell.limits, fast, 1 / 30, lambda _: "")
    reasons += [bent, far.reason, str(problem.value)]
    reasons += [f"the arm cannot begin where it stands: {reasons[0]}"]
    reasons += [f"on the way over {reasons[0]}, after 30% of the way", branch_name(7)]
    assert all(reasons)
    assert untold(reasons) == []


def test_singular_postures_by_each_factor() -> None:
    parts = ("wrist", "elbow", "shoulder")
    factors = [*parts, "wrist+elbow", "wrist+shoulder", "elbow+shoulder", "+".join(parts), "arm"]
    reasons = [f"next to a singularity ({factor})" for factor in factors]
    head = "the joints cannot follow the line 12 mm before the end of the line"
    reasons += [f"{head} ({factor} singular)" for factor in factors if factor != "arm"]
    assert untold(reasons) == []


def test_what_the_watchdog_says() -> None:
    said = []
    for seen in (
        Observation(None, None, None),
        Observation(0.0, 9.9, 9.9),
        Observation(9.9, 0.0, 9.9),
        Observation(9.9, 9.9, 0.0, unreachable="the target has moved 22 mm away from where it was "
                    "to be grasped"),
        Observation(9.9, 9.9, 9.9, device_error="the arm: tcp:10.0.0.2:10001: no answer"),
    ):  # fmt: skip
        limits = made_grab.watch_limits()
        for state in State:
            machine = Machine(True, lambda: 10.0)
            machine.state, machine.since = state, -100.0
            Watchdog(machine, *limits).observe(10.0, seen)
            said += [passage.reason for passage in machine.log]
    assert len(set(said)) > 10
    assert untold(said) == []


def test_what_was_seen_of_the_hand() -> None:
    pose = np.eye(4)
    dark = [LedSight(0.1 * i, "too_few_leds", None, None, None) for i in range(8)]
    apart = [
        LedSight(0.1 * i, "measured", pose + [[0, 0, 0, 0.01 * i]] * 4, np.eye(6) * 1e-9, None)
        for i in range(8)
    ]
    reasons = [f"{agreed(sights, pose)}{GOES_ON}" for sights in (dark, apart)]
    near, far = np.array([1e-3, 0, 0]), np.array([0.012, 0, 0])
    reasons += [said_of(HandOff(off, np.eye(3) * 1e-8, off is near)) for off in (near, far)]
    reasons += [f"the arm did not stand{GOES_ON}"]
    reasons += [f"the way to the corrected place is not clear{GOES_ON}"]
    for reason in reasons:
        for seen in (False, True):
            hand = made_grab.hand(reason, seen=seen)
            assert english(made_grab.results({"hand": hand})) == []


def test_what_the_devices_say() -> None:
    arm = [refused("EXEC", error) for error in (*ERRORS, 9999)]
    for error, stop in ((0, True), (9999, False)):
        arm.append(standing_alarm(RunState("1", False, False, stop, error)))
    back = GivingBack(0.0, override=10)
    back.give_up()
    back.alarm = 9999
    arm += [*back.notes, back.alarm_words(), "powering takes too long; no answer"]
    arm += ["the robot is RV-6S; RV-3SD is expected", "the hand goes at 0.300 m/s"]
    hand = [fault_words(fault) for fault in FAULTS] + [str(RefusedError(c)) for c in EXCEPTIONS]
    hand += ["it has lost its activation; was it without power?", str(RefusedError(77))]
    hand += ["no answer: slave 9 is silent; has it power?"]
    reasons = [f"the arm: tcp:10.0.0.2:10001: {said}" for said in arm]
    reasons += [f"the gripper: /dev/ttyUSB0: {said}" for said in hand]
    assert untold(reasons) == []


def test_german_numbers_are_those_of_the_english() -> None:
    results = made_grab.results({"hand": made_grab.hand(said_of(_off()), seen=True)})
    other = GERMAN.document(document(results))
    said = str(other.sections[0].blocks[0])
    assert "0.52 mm ± 0.20 mm" in said
    assert "berichtigt" in said


def _off() -> HandOff:
    return dataclasses.replace(HandOff(np.zeros(3), np.eye(3) * 1e-8, True),
                               off=np.array([0.52e-3, 0, 0]))  # fmt: skip


def test_the_page_in_german() -> None:
    told = GERMAN.document(document(made_grab.results({"plan": made_grab.plan({})})))
    page = html.page(told)
    assert "Gegriffen und angehoben" in page
    assert "Schulter zugewandt" in page
