"""What parameters do to joint 3 of a recorded session: figures worked out by other hands."""

import numpy as np
import pytest

from tests.beside import shared
from verify import analyse, open_session


@pytest.mark.shared
def test_sensitivities_to_the_table_are_those_of_metrology_md() -> None:
    """metrology.md section 4: on q3, 1 mm in a2 gives 0.76° and in d1 0.60°."""
    results = analyse(open_session(shared("sessions", "multi_joint_fault_6r")))
    table = results.tables["budget_parameters"]
    third = table[table["joint"] == 3].set_index("parameter")["sensitivity_deg"].abs()
    assert third["a2_mm"] == pytest.approx(0.76, abs=0.01)
    assert third["d1_mm"] == pytest.approx(0.60, abs=0.01)
    assert results.summary["budget"]["monte_carlo"]["fails"] == []
    lines = results.tables["budget"].pivot_table(
        index="source", columns="joint", values="standard_uncertainty_deg"
    )
    stated = [joint["standard_uncertainty_deg"] for joint in results.summary["joints"]]
    np.testing.assert_allclose(np.sqrt((lines**2).sum()), stated, rtol=1e-9)


@pytest.mark.shared
def test_the_quarter_circle_is_a_sweep_of_joint_1_and_shows_it_sound() -> None:
    results = analyse(open_session(shared("sessions", "quarter_circle_6r")))
    (sweep,) = results.summary["sweeps"]
    assert sweep["joint"] == 1
    assert sweep["span_deg"] > 90
    assert not sweep["both_directions"]
    assert sweep["hysteresis_deg"] is None
    assert abs(sweep["gain"]) < 3.5 * sweep["gain_standard_uncertainty"]
    assert not sweep["eccentricity_beyond_chance"]
    assert min(sweep["nonlinearity_p_value"], sweep["wobble_p_value"]) > 1e-3
