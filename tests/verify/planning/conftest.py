from collections.abc import Iterator

import pytest

from tests.verify.planning import scene
from verify.planning.plan import Plan
from verify.planning.wishes import Bench


@pytest.fixture(scope="session", autouse=True)
def _few() -> Iterator[None]:
    with scene.few_postures():
        yield


@pytest.fixture(scope="session")
def bench() -> Bench:
    return scene.bench()


@pytest.fixture(scope="session")
def made(bench: Bench, _few: None) -> Plan:
    return scene.planned(bench, scene.wish(), scene.conditions())
