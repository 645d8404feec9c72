"""Causes and detectable faults in the report."""

from dataclasses import replace
from typing import Any

import pandas as pd
import pytest

from reports.document.blocks import Bullets, Facts, Paragraph, Section, Table
from reports.results import Results
from reports.session import causes as session_causes
from reports.session import findings
from reports.session.certificate import certificate
from reports.session.combinations import detectable
from reports.session.headline import headline
from tests.support.reports import session as made

KINDS = {entry["kind"]: entry for entry in made.CAUSES}
UNCLEAR = {
    "joint": None, "kind": "ambiguous", "value": 0.1, "unit": "deg", "explains": 0.3,
    "candidates": [
        KINDS[kind] for kind in ("offset", "gain", "dh", "drift", "base_moved", "camera_skew")
    ],
}  # fmt: skip


def with_causes(causes: list[dict[str, Any]], **summary: Any) -> Results:
    results = made.nonconforming()
    return replace(results, summary=results.summary | {"diagnosis": causes} | summary)


def table_of(section: Section, place: int = 0) -> Table:
    return [block for block in section.blocks if isinstance(block, Table)][place]


def test_every_kind_has_its_remedy() -> None:
    for entry in (KINDS[kind] for kind in KINDS.keys() - {"ambiguous", "novel_kind"}):
        message = headline(with_causes([entry | {"joint": None} if not entry["joint"] else entry]))
        assert session_causes.cause_name(entry)
        assert session_causes.remedy(entry) != "–", entry["kind"]
        assert ":" in session_causes.finding(entry)
        assert "None" not in message.sentence, entry["kind"]


def test_beside_others_a_remedy_on_page_one_names_its_joint() -> None:
    for several in (True, False):
        others = [KINDS["clock"], KINDS["offset"] | {"joint": 6, "value": 3.0}] if several else []
        facts = certificate(with_causes([KINDS["offset"], *others])).blocks
        told = [
            text for b in facts if isinstance(b, Facts) for k, text in b.items if k == "What to do"
        ]
        first = "add −0.400° to its reading"
        joint_6 = "; joint 6: add −3.000° to its reading"
        assert told[0].startswith(f"joint 2: {first}; add −" if several else first)
        assert (joint_6 in told[0]) == several


def test_what_begins_in_the_session_is_stated_with_its_instant() -> None:
    moments = (KINDS["step"], KINDS["base_moved"] | {"t_s": 3.2})
    step, moved = map(session_causes.finding, moments)
    assert step.startswith(
        "joint 4's reading changed by +0.800° ± 0.080° (k = 2) 7.0 s after the first pair: find"
    )
    assert (
        "has moved by 1.20 ± 0.12 mm (k = 2) and 0.081° 3.2 s after the first pair: register"
        in moved
    )


def test_numbers_of_waves_that_explain_the_errors_alike_are_all_stated() -> None:
    entry = {k: v for k, v in KINDS["eccentricity"].items() if k != "phase_deg"}
    entry |= {"per_turn": 39, "per_turn_candidates": [38, 39, 40, 80]}
    assert "a turn: check" in session_causes.finding(entry)
    assert ", 38 to 40 or 80 waves a turn" in session_causes.finding(entry)
    assert session_causes.cause_name(entry) == "eccentricity (38 to 40 or 80 per turn) of joint 5"


def test_signs_are_stated_as_corrections() -> None:
    def finding(kind: str, sign: int = 1) -> str:
        return session_causes.finding(KINDS[kind] | {"value": sign * KINDS[kind]["value"]})

    assert "loses 140" in finding("clock_drift")
    assert "gains 140" in finding("clock_drift", -1)
    assert "later than stamped: add +0.00310 s to t_right_s" in finding("camera_skew")
    assert "earlier than stamped: add −0.00310 s to t_right_s" in finding("camera_skew", -1)
    assert "lag the other joints' by 0.01990 ± 0.00040 s" in finding("latency")
    assert "lead the other joints' by 0.01990 ± 0.00040 s" in finding("latency", -1)
    assert "moved by 1.20 ± 0.12 mm (k = 2) and 0.081°" in finding("base_moved")
    assert (
        "the whole rig, has crept by 0.900 ± 0.090 mm (k = 2) and 0.064° from the first pair to "
        "the last: fix what base and cameras stand on"
    ) in finding("base_drift")
    assert (
        "the right camera has turned by −0.0600° ± 0.0050° (k = 2) against the left one from the "
        "first pair to the last: fix both cameras"
    ) in finding("camera_drift")


def test_of_a_camera_that_was_tilted_it_is_said_when() -> None:
    assert (
        "one of the cameras was tilted by 0.0570° ± 0.0020° (k = 2) in the course of the session: "
        "fix both cameras"
    ) in session_causes.finding(KINDS["camera_tilted"])
    text = session_causes.finding(KINDS["camera_tilted"] | {"t_s": 7.04})
    assert "one of the cameras was tilted by 0.0570° ± 0.0020° (k = 2) " in text
    assert "after the first pair" in text


def test_a_base_that_creeps_against_the_pictures_is_said_to_be_a_camera_that_may_tilt() -> None:
    text = session_causes.finding(KINDS["base_drift"] | {"same_as": "camera_tilted"})
    assert text.endswith("one camera, tilted by about twice the turn, would show the same)")


def test_a_drift_of_the_first_joint_is_said_to_show_as_a_turn_of_the_base_does() -> None:
    text = session_causes.finding(KINDS["drift"] | {"joint": 1, "same_as": "base_turned"})
    assert text.endswith("(the robot base, turned as much about this axis, would show the same)")


def test_the_table_of_causes_names_the_runner_up_and_the_pairs_left_out() -> None:
    rival = made.cause(3, "gain", 0.0074, 0.0007, "ratio") | {"advantage": 953.2}
    causes = [KINDS["offset"] | {"runner_up": rival}, KINDS["gain"]]
    section = findings.diagnosis(with_causes(causes, outlying_pairs=[4, 17]))
    table = table_of(section)
    assert table.rows[0][4].text == "gain of joint 3 (ΔBIC 953)"
    assert table.rows[1][4].text == "–"
    (note,) = [block for block in section.blocks if isinstance(block, Paragraph)]
    assert "2 pairs that lie further off" in note.text
    assert "4, 17" in note.text


def test_many_pairs_left_out_are_not_all_printed() -> None:
    section = findings.diagnosis(with_causes([], outlying_pairs=list(range(80))))
    text = " ".join(block.text for block in section.blocks if isinstance(block, Paragraph))
    assert "and 50 more" in text


@pytest.mark.parametrize(
    ("numbers", "words"),
    [([2], "moving joint 2 alone"), ([2, 3], "moving joints 2 and 3 one at a time")],
)
def test_one_joint_is_moved_alone_and_several_one_at_a_time(numbers: list[int], words: str) -> None:
    entry = UNCLEAR | {"separating_motion": "other_postures", "separating_joints": numbers}
    assert session_causes.separation(entry) == f"record again in other postures, {words}"


@pytest.mark.parametrize("motion", [*session_causes.MOTIONS, "unheard_of"])
@pytest.mark.parametrize("numbers", [[], [3], [3, 4]])
def test_an_ambiguous_entry_names_the_separating_motion(motion: str, numbers: list[int]) -> None:
    entry = UNCLEAR | {"separating_motion": motion, "separating_joints": numbers}
    section = findings.diagnosis(with_causes([entry]))
    cells = [cell.text for cell in table_of(section).rows[0]]
    assert cells[0].endswith("2 others")
    assert cells[1] == cells[2] == "–"
    assert "record" in cells[5]
    assert "{" not in cells[5]


def faults(**more: Any) -> pd.DataFrame:
    rows = [
        (1, "offset", None, None, "deg", None, None),
        (1, "gain", None, None, "ratio", 0.0002, 0.0007),
        (2, "offset", None, None, "deg", 0.0065, 0.087),
        (2, "backlash", None, None, "deg", 0.011, 0.011),
        (2, "eccentricity", None, 1, "deg", 0.02, None),
        (2, "eccentricity", None, 5, "deg", 0.009, 0.018),
        (2, "eccentricity", None, 6, "deg", 0.008, 0.012),
        (2, "dh", "a2", None, "mm", 0.043, 0.14),
        (None, "clock_drift", None, None, "ppm", 82.0, 87.0),
        (None, "base_moved", "rz", None, "deg", 0.008, None),
    ]
    names = ["joint", "kind", "parameter", "per_turn", "unit", "detectable", "separable"]
    return pd.DataFrame(rows, columns=names).assign(**more)


def test_detectable_faults_are_a_table_of_joints_and_kinds() -> None:
    results = made.nonconforming()
    section = detectable(replace(results, tables=results.tables | {"detectable": faults()}))
    (hidden,) = [block for block in section.blocks if isinstance(block, Bullets)]
    assert hidden.items[0] == "A constant offset of joint 1 cannot show."
    assert hidden.items[1].startswith("A gain of joint 2 cannot show")
    assert hidden.items[2] == "Backlash of joint 1 cannot show: it moved one way only."
    first = [[cell.text for cell in line] for line in table_of(section).rows]
    assert first[0] == ["q1", "–", "0.020 / 0.070", *"–––––––"]
    assert first[1] == [
        "q2", "0.0065 / 0.087", "–", "0.011 / 0.011", "0.020 / –", "0.0090 / 0.018", *"––––",
    ]  # fmt: skip
    second = [[cell.text for cell in line] for line in table_of(section, 1).rows]
    assert ["link parameter a2 of joint 2", "0.043", "0.14", "mm"] in second
    assert ["moved robot base or rig, rz", "0.0080", "–", "°"] in second


def test_without_the_table_no_detectability_is_stated() -> None:
    section = detectable(made.nothing())
    assert [block.kind for block in section.blocks] == ["paragraph"]


def test_alarms_of_a_watched_run_are_on_page_one_with_the_cause_that_explains_them() -> None:
    told = [(1, 4, 7.3, "The reading of joint 4 has changed."), (2, None, 9.0, "Target lost.")]
    alarms = pd.DataFrame(told, columns=["alarm", "joint", "t_s", "text"])
    results = with_causes([KINDS["step"]])
    page = certificate(replace(results, tables=results.tables | {"alarms": alarms}))
    rows = [[cell.text for cell in line] for line in table_of(page, 2).rows]
    assert rows[0] == ["1", "7.3", told[0][3], "step of joint 4 at 7.0 s"]
    assert rows[1] == ["2", "9.0", "Target lost.", "–"]
