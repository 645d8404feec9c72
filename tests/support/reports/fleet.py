"""Fleet results of drawn sessions: three arms with six joints over a year. Do not change them."""

from datetime import date
from functools import cache

import pandas as pd

from reports.results import Results
from tests.support.fleets import rows
from verify.fleet.trends.assess import TrendRequest, assess

FAILURES = pd.DataFrame(
    [{"session": 'lab/bad,"x"\ny', "kind": "refused", "why": "lab/bad: has no frames.csv."}]
)


@cache
def changed(since: date | None = None, arm: str = "arm_a") -> Results:
    """Joint 3 of one arm drifts up, joint 5 of arm_b steps up; one session is odd, one reported."""
    sessions = rows(1, drift=0.02, step=0.3, calibrations=3)
    sessions[["verdict", *(f"q{j}_verdict" for j in range(1, 7))]] = "conform"
    other = sessions.index[sessions["robot"] == "arm_b"]
    sessions.loc[other[50:], ["verdict", "q5_verdict"]] = "nonconform"
    sessions.loc[other[20], "q5_mean_error_deg"] += 1.0
    sessions["robot"] = sessions["robot"].replace("arm_a", arm)
    results = _assessed(sessions, since)
    results.tables["worst"].loc[0, "reported"] = True
    return results


@cache
def quiet() -> Results:
    """Nothing changed."""
    return _assessed(rows(1000, sessions=30))


def young() -> Results:
    """Too few sessions to follow anything."""
    return _assessed(rows(1, sessions=2))


def _assessed(sessions: pd.DataFrame, since: date | None = None) -> Results:
    return assess(sessions, FAILURES, TrendRequest(since=since), ())
