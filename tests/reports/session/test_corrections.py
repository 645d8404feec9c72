"""Identified corrections: what to type in, and why nothing where there is nothing."""

from dataclasses import replace
from typing import Any

import pytest

from reports.document.blocks import Table
from reports.results import Results
from reports.session.corrections import corrections
from tests.support.reports import session as made

KINDS = {entry["kind"]: entry for entry in made.CAUSES}


def rows_of(results: Results) -> list[tuple[str, ...]]:
    (table,) = [b for b in corrections(results).blocks if isinstance(b, Table)]
    return [tuple(cell.text for cell in row) for row in table.rows]


def with_causes(*causes: dict[str, Any], **summary: Any) -> Results:
    results = made.nonconforming()
    return replace(results, summary=results.summary | {"diagnosis": list(causes)} | summary)


def test_the_correction_of_an_offset_is_its_negative_with_its_uncertainty() -> None:
    """The sample's truth is an offset of 0.35° (its README.md), which the correction takes off."""
    rows = rows_of(made.nonconforming())
    assert [row[0] for row in rows] == [str(n) for n in range(1, 7)]
    amount, _, rest = rows[1][1].partition("° ± ")
    assert rest.endswith("°, added to the reading")
    assert abs(0.35 + float(amount.replace("−", "-"))) < float(rest.partition("°")[0])
    assert rows[1][2:] == ("constant offset of joint 2", "separated from every other cause")
    for row in rows[:1] + rows[2:]:
        assert row[1:3] == ("no correction", "–")
        assert row[3].startswith("no cause found; detectable 0.00")


@pytest.mark.parametrize(
    ("kind", "typed"),
    [
        ("gain", "counts per turn × 1.00520 ± 0.00040"),
        ("dh", "+0.84 ± 0.20 mm, added to a2 in the robot file"),
        ("clock", "−0.01230 ± 0.00060 s, added to the clock offset"),
        ("latency", "−0.01990 ± 0.00040 s, added to its readings' times"),
        ("camera_skew", "+0.00310 ± 0.00031 s, added to t_right_s"),
        ("backlash", "no correction"),
        ("base_moved", "no correction"),
        ("base_drift", "no correction"),
        ("camera_drift", "no correction"),
        ("geometry", "no correction"),
    ],
)
def test_every_kind_of_cause_says_what_to_type_or_what_else_to_do(kind: str, typed: str) -> None:
    joint = KINDS[kind]["joint"]
    place = -1 if joint is None else joint - 1
    row = rows_of(with_causes(KINDS[kind]))[place]
    assert row[1] == typed
    assert ("no number corrects it: " in row[3]) is (typed == "no correction")


def test_an_offset_beside_a_gain_holds_only_together_with_it() -> None:
    rows = rows_of(with_causes(KINDS["offset"], KINDS["gain"]))
    offset, gain = (row for row in rows if row[0] == "2")
    assert "holds only together with the gain of joint 2" in offset[3]
    assert "holds only together with the constant offset of joint 2" in gain[3]
    assert "gear ratio" in gain[3]


def test_a_common_cause_is_named_where_it_explains_a_joint_s_error() -> None:
    rows = rows_of(with_causes(KINDS["base_moved"]))
    assert rows[1][3] == "no cause of its own; common causes: moved robot base or rig"
    without = rows_of(with_causes())
    assert without[1][3].startswith("no single cause accounts for its error")


def test_what_is_not_separable_or_not_visible_is_not_to_be_corrected() -> None:
    rows = rows_of(made.undecided())
    assert [row[1] for row in rows] == ["no correction"] * 6
    assert rows[0][3].startswith("not visible: ")
    assert rows[2][3].startswith("not separable: constant offset of joint 3")
    assert "constant offset of joint 4" in rows[3][3]


def test_an_offset_that_cannot_show_is_no_correction() -> None:
    joints = [row | {"visible_fraction": 0.0} for row in made.nonconforming().summary["joints"]]
    rows = rows_of(with_causes(KINDS["offset"], KINDS["gain"], joints=joints))
    (offset, gain) = [row for row in rows if row[0] == "2"]
    assert offset[1] == "no correction"
    assert offset[3].startswith("not visible: ")
    assert gain[1].startswith("counts per turn ×")


@pytest.mark.parametrize(
    "cause",
    [KINDS["dh"] | {"value": -252.0, "joint": None}, KINDS["gain"] | {"value": 0.96}],
    ids=["link", "gear"],
)
def test_what_no_arm_could_work_with_is_not_typed_in(cause: dict[str, Any]) -> None:
    rows = [row for row in rows_of(with_causes(cause)) if "too large to be real" in row[3]]
    assert [row[1] for row in rows] == ["no correction"]


@pytest.mark.parametrize("name", ["nulls", "nothing", "seven_joints", "one_pair", "hostile"])
def test_any_results_have_the_section(name: str) -> None:
    for row in rows_of(made.EVERY[name]()):
        assert all(cell and "None" not in cell for cell in row)
