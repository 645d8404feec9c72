from collections.abc import Iterator

import pytest

from tests.support.devices.chromium import Browser, launched


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    with launched(tmp_path_factory.mktemp("chromium")) as started:
        yield started
