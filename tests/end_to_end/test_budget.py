import numpy as np
import pytest
from numpy.testing import assert_allclose

from tests.end_to_end.command import SAMPLES
from verify import analyse, open_session


@pytest.mark.parametrize("name", ["multi_joint_rv_3sd", "multi_joint_fault_6r"])
def test_the_budgets_lines_add_up_to_the_stated_uncertainty(name: str) -> None:
    results = analyse(open_session(SAMPLES / name))
    lines = results.tables["budget"].pivot_table(
        index="source", columns="joint", values="standard_uncertainty_deg"
    )
    stated = [joint["standard_uncertainty_deg"] for joint in results.summary["joints"]]
    # sources of different lines are independent of each other in these files
    assert_allclose(np.sqrt((lines**2).sum()), stated, rtol=1e-9)
