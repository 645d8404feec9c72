from collections.abc import Iterator

import pytest

from tests.support.devices import bench


@pytest.fixture(autouse=True)
def close_what_was_opened() -> Iterator[None]:
    yield
    while bench.opened:
        bench.opened.pop().close()
