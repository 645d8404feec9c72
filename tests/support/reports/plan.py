"""Results of a planned motion of few poses. Do not change them."""

from functools import cache

from reports.results import Results
from tests.support import planning
from verify.planning.request import FAULT_KINDS
from verify.planning.results import PlanProvenance, plan_results

DOUBT = (
    "No uncertainty is stated for rig, robot table: taken as exact; the predicted uncertainties "
    "hold on that condition."
)


@cache
def planned() -> Results:
    given = planning.bench(), planning.wish(observe=FAULT_KINDS), planning.conditions()
    origin = PlanProvenance(*given, {"rig.toml": "sha256:00"}, (DOUBT,))
    with planning.few_postures():
        return plan_results(planning.planned(*given), origin)
