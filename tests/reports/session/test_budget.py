"""Budget, Monte-Carlo check and single-joint sweeps in the report."""

from reports.document.blocks import Bullets, Figure, Paragraph, Section, Table
from reports.document.charts import Chart, Points
from reports.results import Results
from reports.session import document
from tests.support.reports import budget as made_budget
from tests.support.reports import session as made


def section(results: Results, name: str) -> Section:
    return next(s for s in document.document(results).sections if s.name == name)


def texts(part: Section) -> str:
    found: list[str] = []
    for block in part.blocks:
        if isinstance(block, Paragraph):
            found.append(block.text)
        if isinstance(block, Bullets):
            found += block.items
        if isinstance(block, Table):
            found += [block.caption, *block.notes]
            found += [cell.text for row in block.rows for cell in row]
    return "\n".join(found)


def test_the_budget_adds_what_a_reader_checks_it_by() -> None:
    message = section(made_budget.holding(), "budget")
    first = message.blocks[0]
    assert isinstance(first, Paragraph)
    assert first.text.startswith("Known worst is joint ")
    assert "rig, 49 % of the variance" in first.text
    table = next(b for b in message.blocks if isinstance(b, Table) and "by source" in b.caption)
    rows = {row[0].text: [cell.text for cell in row[1:]] for row in table.rows}
    assert rows["rig"][:3] == ["systematic", "B", "40"]
    assert rows["encoder resolution"][2] == "∞"
    assert rows["clock"][3] == "< 0.00001"
    assert rows["correlation of sources"][3].startswith("−")
    assert rows["effective ν"][3] == "> 1000"
    assert rows["effective ν"][4] == "61"
    assert rows["k"][3] == "2.00"
    assert {"random, together", "systematic, together", "combined", "expanded"} <= set(rows)


def test_monte_carlo_states_where_linear_propagation_holds() -> None:
    holds = texts(section(made_budget.holding(), "budget"))
    assert "22 pairs drawn anew 200 times" in holds
    assert "the largest difference is 2.4 %, where 5.0 % are allowed" in holds
    for name in ("q2+q3+q4", "a member by itself", "known best of all", "known worst of all"):
        assert name in holds  # well-known sums beside their members
    fails = texts(section(made_budget.failing(), "budget"))
    assert "It does not hold for joints 3, 4 and 6 at the poses below" in fails
    assert "q4 1.31, q6 1.22" in fails
    assert "the arm cannot stand in some of the drawn poses" in fails
    alone, coupled = (
        texts(section(made_budget.failing_at(joints, coupled=len(joints) > 1), "budget"))
        for joints in ([4], [4, 6])
    )
    assert "for joint 4 at" in alone
    assert "fails only for joints that a singularity couples" in coupled


def test_sweeps_report_only_significant_effects() -> None:
    sound = texts(section(made_budget.holding(), "relative"))
    assert "Turned alone, joints 1, 2, 3, 4, 5 and 6: the encoder follows" in sound
    faulty = texts(section(made_budget.failing(), "relative"))
    assert "Joint 1: gear error +0.500 ± 0.040 % (k = 2)." in faulty
    assert "Joint 2: hysteresis −0.3010° ± 0.0080° (k = 2)." in faulty
    assert "Joint 3: eccentricity 0.210° ± 0.040° (k = 2), once a turn." in faulty
    assert "Joint 4: its errors follow no known curve" in faulty
    assert "Joint 5: the flange does not turn about one fixed axis" in faulty
    assert "Joint 6: " not in faulty
    assert "Left out of joint 5's sweep" in faulty
    assert "pairs 207, 219." in faulty
    assert "Left out" not in sound
    assert "< 0.14" in faulty  # an amplitude that chance explains is a bound
    assert "follows the turn" not in faulty


def test_without_a_sweep_the_required_motion_is_named() -> None:
    part = section(made.nonconforming(), "relative")
    assert [b for b in part.blocks if isinstance(b, Paragraph)][-1].text.startswith(
        "No single-joint sweep: turn one joint alone"
    )


def test_a_sweep_is_drawn_either_way() -> None:
    part = section(made_budget.failing(), "relative")
    drawing = next(b for b in part.blocks if isinstance(b, Figure) and b.name == "sweeps").drawing
    assert isinstance(drawing, Chart)
    assert [panel.title for panel in drawing.panels] == [f"joint {j}" for j in range(1, 7)]
    names = {m.name for panel in drawing.panels for m in panel.marks if isinstance(m, Points)}
    assert names == {"on the way up", "on the way down"}
