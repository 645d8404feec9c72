"""The report of a planned session: its words and its pictures."""

from copy import deepcopy
from dataclasses import replace

import numpy as np
import pytest

from reports import render_html, render_pdf
from reports.document.blocks import Facts, Verdict, collect_figures
from reports.plan.document import document
from reports.results import Results
from tests.support.reports.page import tables
from tests.support.reports.plan import planned
from verify.planning.proposal import ProposedRig
from verify.planning.results import rig_entry

PICTURES = {"plan_detectable", "correlation", "plan_joints", "plan_path", "plan_view"}


def through_encoders(plain: Results) -> Results:
    """The same where joints 1 and 6 cannot show, and nothing of geometry was asked for."""
    summary = deepcopy(plain.summary) | {"through_encoders": True, "geometry": None}
    summary["clock"] = {"source": "estimated", "standard_uncertainty_s": 1e-4}
    for joint in (0, 5):
        for key in ("standard_uncertainty_deg", "minimum_detectable_error_deg"):
            summary["joints"][joint][key] = None
    return replace(plain, summary=summary)


@pytest.fixture(scope="module")
def every() -> dict[str, Results]:
    plain = planned()
    return {
        "plain": plain,
        "blind": through_encoders(plain),
        "bare": Results({"kind": "plan"}, {}, {}),
    }


def test_the_verdict_is_first(every: dict[str, Results]) -> None:
    first = document(every["plain"]).sections[0].blocks[0]
    assert isinstance(first, Verdict)
    assert first.sentence.startswith("The mean error of each joint will be known to ±0.")
    assert "A constant offset of 0." in first.sentence
    assert first.sentence.endswith("° or more will be detected in every joint.")
    assert any("Taken as exact" in remark for remark in first.remarks)


def test_undetectable_offsets_are_stated_with_the_cause(every: dict[str, Results]) -> None:
    assert "geometry" in [section.name for section in document(every["plain"]).sections]
    sections = document(every["blind"]).sections
    assert "geometry" not in [section.name for section in sections]
    first = sections[0].blocks[0]
    assert isinstance(first, Verdict)
    assert "detected in joints 2, 3, 4 and 5." in first.sentence
    assert "This motion cannot show an offset of joints 1 and 6." in first.sentence
    assert first.tone == "undecided"
    assert first.remarks[0].startswith("Base or LEDs were registered through")


def test_the_poses_follow_the_answer(every: dict[str, Results]) -> None:
    """Each pose once, where it is first reached."""
    for one in every.values():
        assert [section.name for section in document(one).sections[:2]] == ["verdict", "poses"]
    table = tables(document(every["plain"]))["The poses."]
    assert [row[0].text for row in table.rows] == ["1", "2", "3", "4", "5"]
    reached = [float(row[1].text) for row in table.rows]
    assert reached == sorted(reached)
    stops = every["plain"].table("poses")
    third = stops[stops["pose"] == 3].iloc[0]
    assert float(table.rows[2][2].text.replace("−", "-")) == pytest.approx(
        third["q1_deg"], abs=0.05
    )


def test_a_rig_to_be_built_is_described_with_what_is_assumed(every: dict[str, Results]) -> None:
    plain = every["plain"]
    rig = ProposedRig()
    summary = plain.summary | {"rig": rig_entry(rig)}
    page = document(replace(plain, summary=summary))
    first, facts = page.sections[0].blocks[:2]
    assert isinstance(first, Verdict)
    assert isinstance(facts, Facts)
    assert any("does not exist yet" in remark for remark in first.remarks)
    assert dict(facts.items)["Cameras"] == "1280 × 720 px, 60° wide"
    assumed = tables(page)[
        "Standard uncertainties assumed of a rig that does not exist yet (k = 1)."
    ]
    assert [float(row[1].text) for row in assumed.rows] == list(rig.uncertainties.values())


def test_parts_make_up_the_uncertainty_that_is_printed(every: dict[str, Results]) -> None:
    caption = "How well the mean error of each joint will be known, and what limits it (k = 2)."
    table = tables(document(every["plain"]))[caption]
    for row in table.rows:
        whole, parts = float(row[1].text), [float(cell.text) for cell in row[3:-1]]
        assert whole**2 == pytest.approx(sum(part**2 for part in parts), rel=0.15)


def test_no_source_that_counts_is_shown_as_zero(every: dict[str, Results]) -> None:
    """A good motion learns the rig: what is left of that source is tiny, and is not nothing."""
    parts = every["plain"].tables["sources"]
    tiny = parts.assign(standard_uncertainty_deg=1e-3 * parts["standard_uncertainty_deg"])
    results = replace(every["plain"], tables={**every["plain"].tables, "sources": tiny})
    table = tables(document(results))["What the uncertainty of each joint's mean error comes from."]
    assert all(float(cell.text) > 0 for row in table.rows for cell in row[1:])


def test_every_picture_is_there(every: dict[str, Results]) -> None:
    assert set(collect_figures(document(every["plain"]))) == PICTURES
    assert not collect_figures(document(every["bare"]))
    assert render_pdf(every["plain"]).startswith(b"%PDF")
    for one in every.values():
        assert "<html" in render_html(one)


def test_each_kind_has_its_columns(every: dict[str, Results]) -> None:
    table = tables(document(every["plain"]))["What would show of each kind of fault."]
    assert table.head[1::2] == (
        "Offset, U [°]", "Gain, U [%]", "Backlash, U [°]", "Eccentricity, U [°]",
    )  # fmt: skip
    assert len(table.rows) == 6
    shown = every["plain"].table("shown")
    first = shown[(shown["joint"] == 1) & (shown["kind"] == "gains")].iloc[0]
    stated = 2 * first["standard_uncertainty"]  # readers get k = 2
    assert float(table.rows[0][3].text) == pytest.approx(stated, rel=0.06)


def test_the_trajectory_is_even_and_ends_at_rest(every: dict[str, Results]) -> None:
    table = every["plain"].table("trajectory")
    assert list(table.columns) == ["t_s", *(f"q{j}_deg" for j in range(1, 7)), "pose"]
    steps = np.diff(table["t_s"])
    np.testing.assert_allclose(steps[:-1], 0.05)
    assert table["pose"].iloc[0] == table["pose"].iloc[-1] == 1
