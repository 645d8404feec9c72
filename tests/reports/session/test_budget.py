"""Budget, Monte-Carlo check and single-joint sweeps in the report."""

import re
from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd
import pytest

from reports.document.blocks import Figure, Paragraph, Section, Table, to_template_data
from reports.document.charts import Chart, Points
from reports.results import Results
from reports.session import document
from tests.support.reports import session as made
from tests.support.reports.page import strings


def holding() -> Results:
    """A budget that Monte Carlo confirms; every joint swept alone and sound."""
    return _with([], [_sweep(joint) for joint in range(1, 7)])


def failing() -> Results:
    """Linear propagation fails at a few pairs; sweeps show one fault each."""
    fails = [
        {"frame": 12, "joints": [4, 6], "ratio": [1.31, 1.22], "coupled": False,
         "unreachable": 0.0},
        {"frame": 31, "joints": [3], "ratio": [None], "coupled": False, "unreachable": 0.31},
        {"frame": 44, "joints": [4, 6], "ratio": [2.4, 2.6], "coupled": True, "unreachable": 0.0},
    ]  # fmt: skip
    sweeps = [
        _sweep(1, gain=0.005),
        _sweep(2, hysteresis_deg=-0.301),
        _sweep(3, eccentricity_deg=0.21, eccentricity_standard_uncertainty_deg=0.02,
               eccentricity_phase_deg=14.0, eccentricity_beyond_chance=True),
        _sweep(4, nonlinearity_p_value=1e-9, nonlinearity_rms_deg=0.081),
        _sweep(5, wobble_p_value=1e-7, wobble_rms_mm=0.31, wobble_rms_deg=0.09,
               outlying_frames=[207, 219]),
        _sweep(6, hysteresis_deg=None, hysteresis_standard_uncertainty_deg=None,
               both_directions=False),
    ]  # fmt: skip
    return _with(fails, sweeps)


def failing_at(joints: list[int], *, coupled: bool) -> Results:
    """Linear propagation fails at one pair: for one joint, or for joints that enter no figure."""
    fails = {"frame": 4, "joints": joints, "ratio": [2.4] * len(joints), "unreachable": 0.0}
    return _with([fails | {"coupled": coupled}], [_sweep(3)])


def _with(fails: list[dict[str, Any]], sweeps: list[dict[str, Any]]) -> Results:
    plain = made.nonconforming()
    budget, lines = plain.summary["budget"], plain.tables["budget"]
    joints = [row | {"effective_degrees_of_freedom": None} for row in budget["joints"][:1]]
    found = {"joints": joints + budget["joints"][1:]}
    found["monte_carlo"] = budget["monte_carlo"] | {"fails": fails}
    tied = lines[lines["source"] == "pixels"].assign(source="correlation of sources")
    lines = pd.concat([lines, tied.assign(standard_uncertainty_deg=-0.001)])
    return replace(
        plain,
        summary=plain.summary | {"budget": budget | found, "sweeps": sweeps},
        tables=plain.tables | {"budget": lines, "sweeps": _pairs(sweeps)},
    )


def _sweep(joint: int, **other: Any) -> dict[str, Any]:
    return {
        "joint": joint, "pairs": 40, "first_frame": 40 * joint, "last_frame": 40 * joint + 39,
        "outlying_frames": [], "span_deg": 42.5, "both_directions": True, "gain": 0.0001,
        "gain_standard_uncertainty": 0.0002, "hysteresis_deg": 0.002,
        "hysteresis_standard_uncertainty_deg": 0.004, "eccentricity_deg": 0.04,
        "eccentricity_standard_uncertainty_deg": 0.05, "eccentricity_phase_deg": None,
        "eccentricity_phase_standard_uncertainty_deg": None, "eccentricity_beyond_chance": False,
        "nonlinearity_rms_deg": 0.012, "nonlinearity_rms_standard_uncertainty_deg": 0.001,
        "noise_rms_deg": 0.011, "nonlinearity_p_value": 0.4, "wobble_rms_mm": 0.05,
        "wobble_rms_deg": 0.03, "wobble_p_value": 0.6, **other,
    }  # fmt: skip


def _pairs(sweeps: list[dict[str, Any]]) -> pd.DataFrame:
    rng = np.random.default_rng(3)
    angle = 20 * np.sin(np.linspace(0, 2 * np.pi, 40))
    direction = np.where(np.gradient(angle) >= 0, 1.0, -1.0)
    pairs = pd.DataFrame({"frame": range(40), "angle_deg": angle, "direction": direction})
    parts = [
        pairs.assign(
            sweep=number, joint=sweep["joint"], error_deg=rng.normal(0.05 * direction, 0.01)
        )
        for number, sweep in enumerate(sweeps, start=1)
    ]
    return pd.concat(parts).assign(u_deg=0.01, curve_deg=lambda rows: 0.05 * rows["direction"])


def section(results: Results, name: str) -> Section:
    return next(s for s in document.document(results).sections if s.name == name)


def texts(part: Section) -> str:
    return "\n".join(strings(to_template_data(part)))


def test_the_budget_adds_what_a_reader_checks_it_by() -> None:
    message = section(holding(), "budget")
    first = message.blocks[0]
    assert isinstance(first, Paragraph)
    assert first.text == (
        "Joint 4 has the largest uncertainty, U = 0.0045°. "
        "Its largest source: pixels, 68 % of the variance."
    )
    table = next(b for b in message.blocks if isinstance(b, Table) and "by source" in b.caption)
    rows = {row[0].text: [cell.text for cell in row[1:]] for row in table.rows}
    assert rows["pixels"][:3] == ["random", "A", "339"]
    assert rows["alignment of the two instants"][:4] == ["systematic", "B", "∞", "< 0.00001"]
    assert rows["correlation of sources"][3].startswith("−")
    assert rows["effective ν"][3] == "> 1000"
    assert rows["effective ν"][4] == "339"
    assert rows["k"][3] == "2.00"
    assert {"random, together", "systematic, together", "combined", "expanded"} <= set(rows)


@pytest.mark.parametrize("factor", [2.0, 13.97])  # the latter: of two pairs
def test_a_sum_has_the_figures_of_the_weights_that_its_name_states(factor: float) -> None:
    results = made.nonconforming()
    joints = [joint | {"coverage_factor": factor} for joint in results.summary["joints"]]
    results = replace(results, summary=results.summary | {"joints": joints})
    joints, correlation = results.summary["joints"], np.eye(6)
    correlation[1, 5] = correlation[5, 1] = 0.05  # joint 2's error has a weight under a tenth
    correlation[2, 3] = correlation[3, 2] = -0.3
    tied = results.summary | {"joint_error_correlation": correlation.tolist()}
    results = replace(results, summary=tied)
    table = next(
        block for block in section(results, "budget").blocks
        if isinstance(block, Table) and "those known well" in block.caption
    )  # fmt: skip
    mean, u = (
        np.array([joint[key] for joint in joints])
        for key in ("mean_error_deg", "standard_uncertainty_deg")
    )
    covariance = correlation * np.outer(u, u)
    spreads = []
    for label, figures, k, why in (tuple(cell.text for cell in row) for row in table.rows):
        if "of all sums" not in why:
            continue
        weights = np.zeros(len(joints))
        for sign, size, joint in re.findall(r"(\+|−|^)(?:([\d.]+)·)?q(\d)", label):
            weights[int(joint) - 1] = float(size or 1) * (-1 if sign == "−" else 1)
        value, spread = (float(text.replace("−", "-")) for text in figures.split(" ± "))
        digit = 10.0 ** -len(figures.partition(".")[2].partition(" ")[0])
        spreads.append(factor * np.sqrt(weights @ covariance @ weights))
        assert k == f"{factor:g}"
        assert abs(value - weights @ mean) <= 0.501 * digit
        assert abs(spread - spreads[-1]) <= 0.501 * digit
    ratio = re.search(r"([\d.]+) times as uncertain", table.notes[0])
    assert ratio
    assert float(ratio[1]) == pytest.approx(spreads[1] / spreads[0], rel=0.05)


def test_a_negative_figure_of_the_budget_is_explained() -> None:
    results = made.nonconforming()
    lines = results.table("budget")
    for kept, said in ((lines, True), (lines[lines["standard_uncertainty_deg"] >= 0], False)):
        of = replace(results, tables={**results.tables, "budget": kept})
        assert ("A negative figure" in texts(section(of, "budget"))) == said


def test_monte_carlo_states_where_linear_propagation_holds() -> None:
    holds = texts(section(holding(), "budget"))
    check = made.nonconforming().summary["budget"]["monte_carlo"]
    largest = 100 * max(joint["largest_difference"] for joint in check["joints"])
    assert f"{check['pairs']} pairs, each simulated 200 times" in holds
    assert f"the largest difference is {largest:.1f} %, where 5.0 % are allowed" in holds
    for name in ("q2+q3+q4", "a member by itself", "known best of all", "known worst of all"):
        assert name in holds  # well-known sums beside their members
    fails = texts(section(failing(), "budget"))
    assert "It does not hold for joints 3, 4 and 6 at the poses below" in fails
    assert "q4 1.31, q6 1.22" in fails
    assert "the arm cannot stand in some of the drawn poses" in fails
    alone, coupled = (
        texts(section(failing_at(joints, coupled=len(joints) > 1), "budget"))
        for joints in ([4], [4, 6])
    )
    assert "for joint 4 at" in alone
    assert "fails only for joints that a singularity couples" in coupled


def test_sweeps_report_only_significant_effects() -> None:
    sound = texts(section(holding(), "relative"))
    assert "Turned alone, joints 1, 2, 3, 4, 5 and 6: the encoder follows" in sound
    faulty = texts(section(failing(), "relative"))
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
    *_, last = (block.text for block in part.blocks if isinstance(block, Paragraph))
    assert last.startswith("No single-joint sweep: turn one joint alone")


def test_a_sweep_is_drawn_either_way() -> None:
    part = section(failing(), "relative")
    drawing = next(b for b in part.blocks if isinstance(b, Figure) and b.name == "sweeps").drawing
    assert isinstance(drawing, Chart)
    assert [panel.title for panel in drawing.panels] == [f"joint {j}" for j in range(1, 7)]
    names = {m.name for panel in drawing.panels for m in panel.marks if isinstance(m, Points)}
    assert names == {"on the way up", "on the way down"}
