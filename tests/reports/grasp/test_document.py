"""The report of a grasp: verdict, figures, missing measurements."""

from dataclasses import replace
from typing import Any

import pandas as pd
import pytest

from reports.document.blocks import Facts, collect_figures
from reports.document.charts import Level, legend
from reports.format import html, pdf
from reports.grasp import figures as grasp_figures
from reports.grasp.certificate import outcome
from reports.grasp.document import document
from reports.results import Results
from tests.support.reports.grasp import PLAN, SUMMARY, grabbed
from tests.support.reports.page import page_one, tables

BARE = {"kind": "grab", "robot": "an arm", "target": "blue object", "cell": "simulated"}


@pytest.mark.parametrize(
    ("summary", "tone", "label"),
    [
        ({"execute": True, "state": "lifted", "reason": "held"}, "conform", "Grasped and lifted"),
        ({"execute": True, "state": "missed", "reason": "empty"}, "nonconform", "Missed"),
        ({"execute": True, "state": "fault", "reason": "alarm"}, "nonconform", "fault"),
        ({"execute": True, "state": "holding-lost", "reason": "gone"}, "undecided", "out of sight"),
        ({"execute": True, "state": "following", "reason": ""}, "undecided", "while following"),
        ({"state": "idle", "reason": "no pictures yet"}, "undecided", "while idle"),
        ({"execute": False, "state": "searching", "reason": ""}, "undecided", "not found"),
        ({"state": "tracking", "plan": {"branch": "b", "duration_s": 4.9}}, "none", "Planned"),
        ({"state": "tracking", "refusal": {"reason": "too wide"}}, "undecided", "Refused"),
    ],
)
def test_each_final_state_has_its_verdict(
    summary: dict[str, object], tone: str, label: str
) -> None:
    message = outcome(summary)
    assert message.tone == tone
    assert label in message.label
    assert "None" not in message.sentence


def test_who_ended_it_and_what_it_waited_for_are_said() -> None:
    idle = {"execute": False, "state": "idle", "reason": "no joint angles yet"}
    waited = "Its time was over. It had not begun: no joint angles yet."
    assert outcome(idle).sentence == waited
    stopped = {"execute": True, "state": "following", "stopped_by_operator": True}
    assert outcome(stopped).sentence == "The operator ended it."


BY_GRIPPER = "The object came along, by the gripper's status; the cameras"
FAR = "16 ± 23 mm (k = 2)"
RAISED = f"saw the object last {FAR} from the grip point, with the hand 120 mm up."
SEEN = {
    "seen_from_grip_mm": 15.83, "seen_from_grip_expanded_uncertainty_mm": 23.13,
    "seen_raised_mm": 119.99,
}  # fmt: skip
UNSEEN = dict.fromkeys(SEEN)


@pytest.mark.parametrize(
    ("changes", "sentence", "fact"),
    [
        (SEEN, f"{BY_GRIPPER} {RAISED}", FAR),
        (UNSEEN, f"{BY_GRIPPER} did not see it after the descent.", "not seen after the descent"),
        (UNSEEN | {"state": "missed"}, None, None),
    ],
)  # fmt: skip
def test_the_verdict_names_the_evidence_for_the_lift(
    changes: dict[str, Any], sentence: str | None, fact: str | None
) -> None:
    if sentence is not None:
        assert outcome(SUMMARY | changes).sentence == sentence
    output = document(grabbed(changes))
    facts = next(block for block in output.sections[0].blocks if isinstance(block, Facts))
    assert dict(facts.items).get("Object off grip point") == fact
    assert "– mm" not in str(facts)


def test_an_object_that_the_cameras_see_left_behind_is_not_called_lifted() -> None:
    verdict = outcome(SUMMARY | SEEN | {"seen_from_grip_mm": 118.0})
    assert (verdict.tone, verdict.label) == ("undecided", "The object stayed behind")
    assert verdict.sentence.startswith(
        "Something is held, by the gripper's status; the cameras saw"
    )
    near = {"seen_from_grip_mm": 60.0, "seen_from_grip_expanded_uncertainty_mm": 20.0}
    assert outcome(SUMMARY | SEEN | near).tone == "conform"  # its uncertainty reaches the hand


def test_small_scores_keep_their_digits() -> None:
    parts = {"limits": 0.45, "dexterity": 0.2319, "nearness": 0.99992, "clearance": 0.001}
    plan = PLAN | {"score": 0.000104327, "parts": parts}
    every = tables(document(grabbed({"plan": plan}))).values()
    (message,) = [str(cell) for table in every for row in table.rows for cell in row
                  if "score 0" in str(cell)]  # fmt: skip
    for words in ("score 0.00010 (", "clearance 0.0010", "dexterity 0.23"):
        assert words in message


def test_time_is_written_once_below_panels_that_share_it() -> None:
    results = grabbed({})
    for chart, lowest in (
        (grasp_figures.windows(results), 1),
        (grasp_figures.joints(results), 2),
        (grasp_figures.planned_motion(results), 2),
    ):
        labels = [panel.x_label for panel in chart.panels]
        assert labels == [""] * (len(labels) - lowest) + ["time [s]"] * lowest
        assert lowest == chart.columns


def test_missing_measurements_are_stated_and_not_drawn() -> None:
    output = document(Results(BARE | {"state": "searching"}, {}, {"cycles": pd.DataFrame()}))
    assert collect_figures(output) == {}
    blocks = [block for section in output.sections for block in section.blocks]
    words = " ".join(str(getattr(block, "text", "")) for block in blocks)
    for message in ("no pictures", "was not seen", "found nothing", "No joint angles", "no plan"):
        assert message in words


def test_page_one_has_the_pictures_the_times_and_what_the_gripper_alone_says() -> None:
    given = grabbed(UNSEEN)
    results = replace(given, images={"pictures": b"png"}, films={"grab.mp4": b"film"})
    first = page_one(document(results))
    for words in (
        "Both cameras, left and right.", "Times of the grab.", "Total time 8.0 s.",
        "What to do Nothing", "Not checked Whether the cameras confirm the lift",
    ):  # fmt: skip
        assert words in first


@pytest.mark.parametrize(("size", "held"), [(300_000, True), (1_000_000, False)])
def test_a_film_is_in_the_page_where_it_is_small_enough_else_the_page_says_where_it_lies(
    size: int, held: bool
) -> None:
    results = replace(grabbed({}), films={"grab.mp4": b"\0" * size})
    page = html.page(document(results))
    assert len(page.encode()) <= html.MAX_PAGE_BYTES
    assert ('src="data:video/mp4;base64,AAAA' in page) is held
    assert '<a href="grab.mp4">grab.mp4</a>' in page
    assert "Film of the grab" in str(pdf.typst_files(document(results))["report.json"])


def test_a_plan_alone_is_a_sentence_and_its_pictures_are_not_called_a_grasp() -> None:
    plan = {"branch": "shoulder facing, elbow +", "duration_s": 4.9}
    words = "A safe way leads to the target, with shoulder facing, elbow +; it takes 4.9 s."
    assert outcome({"state": "tracking", "plan": plan}).sentence == words
    made = replace(grabbed({}), images={"pictures": b""})
    cycles = made.table("cycles").assign(state="tracking")
    planned = replace(made, tables={**made.tables, "cycles": cycles})
    assert "Both cameras, left and right, at the end." in page_one(document(planned))
    closing = cycles.assign(state=["following"] + ["closing"] * (len(cycles) - 1))
    executed = replace(made, tables={**made.tables, "cycles": closing})
    assert "Above: the object before the grasp; below: the grasp." in page_one(document(executed))


def test_a_part_of_the_plan_that_is_no_motion_has_no_word_in_the_legend() -> None:
    made = grabbed({})
    plan = made.table("plan")
    once = plan[(plan["part"] != "over") | ~plan["part"].duplicated()]
    chart = grasp_figures.planned_motion(replace(made, tables={**made.tables, "plan": once}))
    assert chart is not None
    assert list(legend(chart)) == ["down", "up"]


def test_the_two_clearances_are_told_apart() -> None:
    chart = grasp_figures.margins(grabbed({"plan": PLAN}))
    assert chart is not None
    limits = [mark.role for mark in chart.panels[0].marks if isinstance(mark, Level)]
    assert len(limits) == len(set(limits)) == 2
