from collections.abc import Iterator

import pytest

from tests.support.devices import bench
from tests.support.devices.chromium import Browser, launched


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    with launched(tmp_path_factory.mktemp("chromium")) as started:
        yield started


@pytest.fixture(autouse=True)
def close_what_was_opened() -> Iterator[None]:
    yield
    while bench.opened:
        bench.opened.pop().close()
