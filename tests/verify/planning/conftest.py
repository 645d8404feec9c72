from collections.abc import Iterator

import pytest

from tests.support import planning
from verify.planning.plan import SessionPlan
from verify.planning.request import PlanningSetup


@pytest.fixture(scope="session", autouse=True)
def _few() -> Iterator[None]:
    with planning.few_postures():
        yield


@pytest.fixture(scope="session")
def bench() -> PlanningSetup:
    return planning.bench()


@pytest.fixture(scope="session")
def made(bench: PlanningSetup, _few: None) -> SessionPlan:
    return planning.planned(bench, planning.wish(), planning.conditions())
