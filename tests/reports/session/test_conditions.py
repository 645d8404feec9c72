"""Hidden offsets and missing statements on the first page and in the setup."""

import re
import shutil
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import pytest

import reports
from reports.document.blocks import Facts
from reports.results import Results
from reports.session import evidence
from reports.session.conditions import conditions
from reports.session.headline import headline
from tests.support import recorded
from tests.support.command import SAMPLES
from tests.support.reports import session as made
from tests.support.reports.page import LIBRARY
from verify import analyse, open_session

SAMPLE = SAMPLES / "multi_joint_fault_6r"
BASE = "A constant offset of joint 1 cannot show here: the robot base was found through the same "
FOUND = {"visible_fraction": 0.0, "visible_fraction_since_registration": 1.0}
UNSEEN = FOUND | {"reason": "not_observable"}


@pytest.fixture(scope="module")
def registered_by_motion(tmp_path_factory: pytest.TempPathFactory) -> Results:
    """The sample session, its base said to come from a motion: joint 1 is hidden, 2 fails."""
    folder = shutil.copytree(SAMPLE, tmp_path_factory.mktemp("hidden") / "session")
    recorded.replace(folder / "rig.toml", 'source = "fixture"', 'source = "motion"')
    return analyse(open_session(folder))


def test_the_first_page_lists_what_a_registration_by_motion_hides(
    registered_by_motion: Results,
) -> None:
    message = headline(registered_by_motion)
    assert message.tone == "nonconform"
    assert message.remarks[1:3] == ("Whether joint 1 conforms is undecided.", f"{BASE}encoders.")
    page = reports.render_html(registered_by_motion).replace(LIBRARY, "")
    verdict, found = page.index("The robot does not conform"), page.index(BASE)
    assert verdict < found < page.index("Mean and largest error", verdict)


def _results(changes: dict[int, dict[str, Any]], **more: Any) -> Results:
    """Joints changed by number; `setup` names sources, the rest is of the summary."""
    base = made.nonconforming()
    setup = dict(base.setup)
    for part, entry in more.pop("setup", {}).items():
        setup[part] = setup[part] | entry
    rows = [row | changes.get(row["joint"], {}) for row in base.summary["joints"]]
    return replace(base, summary=base.summary | {"joints": rows} | more, setup=setup)


MOTION = {"rig": {"base_source": "motion"}, "marker": {"source": "motion"}}
WRIST = [{"label": "q4+q6", "joints": [4, 6], "why": "singularity"}]
BLIND = {"encoder_offset_s": None, "source": "none", "observable": False}
CASES: dict[str, tuple[Callable[[], Results], str, str, str]] = {
    "base and LEDs": (
        partial(_results, {1: UNSEEN, 6: UNSEEN}, setup=MOTION),
        "joints 1 and 6",
        "the robot base and the LED positions were found through the same encoders",
        "first give the robot base and the LED positions by a fixture",
    ),
    "LEDs alone": (
        partial(_results, {6: UNSEEN}, setup={"marker": {"source": "motion"}}),
        "joint 6",
        "the LED positions were found through the same encoders",
        "first give the LED positions by a fixture",
    ),
    "a tracker's target": (
        partial(
            _results,
            {6: UNSEEN},
            setup={"marker": {"source": "motion", "point_mm": [0.0, 0.0, 1.0]}},
        ),
        "joint 6",
        "the measured point was found through the same encoders",
        "first give the measured point by a fixture",
    ),
    "the clock": (
        partial(_results, {1: UNSEEN | {"visible_fraction_since_registration": 0.0}}, clock=BLIND),
        "joint 1",
        "the motion does not separate it from an offset of the encoder clock",
        "first give the clock offset",
    ),
    "a singularity": (
        partial(_results, {4: {"reason": "not_observable"}}, combinations=WRIST),
        "joint 4",
        "near a singularity only the sum q4+q6 is determined",
        "first record poses away from the singularity",
    ),
    "a single LED on the last axis": (
        partial(
            _results, {6: {"reason": "not_observable", "visible_fraction": None}}, combinations=[]
        ),
        "joint 6",
        "the measured poses do not determine it",
        "first record other poses",
    ),
}


@pytest.mark.parametrize("name", CASES)
def test_hidden_offsets_are_stated_with_every_verdict(name: str) -> None:
    made_results, named, why, _ = CASES[name]
    results = made_results()
    for verdict in ("conform", "nonconform", "undecided", None):
        message = headline(replace(results, summary=results.summary | {"verdict": verdict}))
        assert f"A constant offset of {named} cannot show here: {why}." in message.remarks, verdict


@pytest.mark.parametrize("name", CASES)
def test_an_undecided_verdict_names_what_would_decide_it(name: str) -> None:
    made_results, named, _, remedy = CASES[name]
    results = made_results()
    rows = [
        row | ({"verdict": "undecided"} if row["reason"] == "not_observable" else {})
        for row in results.summary["joints"]
    ]
    summary = results.summary | {"verdict": "undecided", "joints": rows}
    message = headline(replace(results, summary=summary))
    assert f"an offset of {named} cannot show: {remedy}" in message.sentence
    assert "in this session" not in " ".join(message.remarks)  # said above, with its reason


def test_a_hidden_constant_is_stated_beyond_the_tolerance_too_and_only_where_it_is_hidden() -> None:
    message = headline(_results({3: FOUND}, setup={"rig": {"base_source": "motion"}}))
    assert any("offset of joint 3 cannot show here" in remark for remark in message.remarks)
    assert not any("cannot show" in remark for remark in headline(made.nonconforming()).remarks)


def test_an_undecided_joint_beside_a_failing_one_has_its_reason() -> None:
    row = {"verdict": "undecided", "reason": "uncertainty_too_large"}
    remarks = headline(_results({4: row})).remarks
    assert "Joint 4: uncertainty too large for this tolerance." in remarks


def _facts(results: Results) -> dict[str, str]:
    blocks = conditions(results).blocks
    return dict(item for block in blocks if isinstance(block, Facts) for item in block.items)


MISSING = (
    "Registration", "LED positions", "Datum", "u of the body", "u of each LED",
    "u of the apparent centre",
)  # fmt: skip


def test_statements_are_shown_and_missing_ones_reported(registered_by_motion: Results) -> None:
    facts = _facts(registered_by_motion)
    assert {facts[label] for label in MISSING} == {"not stated"}
    setup = {"rig": {"registration": "of monday"}, "marker": {"led_standard_uncertainty_mm": 0.05}}
    facts = _facts(_results({}, setup=setup))
    assert facts["Registration"] == "of monday"
    assert facts["u of each LED"] == "0.050 mm"


def test_where_another_instrument_measured_no_camera_and_no_led_is_blamed() -> None:
    results = made.nonconforming()
    hidden = results.summary["clock"] | {"observable": False, "standard_uncertainty_s": None}
    posed = replace(
        results,
        summary=results.summary | {"clock": hidden},
        setup=results.setup | {"instrument": {"name": "a laser tracker"}},
    )
    posed.summary["relative_motions"] = posed.summary["relative_motions"] | {"p_value": 6.2e-6}
    blocks = (*evidence.relative_motions(posed), evidence.clock(posed).blocks[0])
    said = " ".join(getattr(block, "text", "") for block in blocks)
    assert "with probability 0.0000062. They do not agree: something is wrong with arm, " in said
    assert "instrument or clock" in said
    assert "encoder clock and the instrument's clock could not be observed." in said
    assert not re.search("camera|LED", said)
    pictured = evidence.clock(replace(posed, setup=results.setup)).blocks[0]
    assert "the cameras' clock could not be observed." in getattr(pictured, "text", "")
