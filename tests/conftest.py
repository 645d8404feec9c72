import os
from collections.abc import Generator

import pytest
from hypothesis import settings

# as the command line does, before numpy is first imported: small matrices want one thread
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

# a machine may be busy for a moment: no test is timed
settings.register_profile("untimed", deadline=None)
settings.load_profile("untimed")

README = "tests/end_to_end/test_documentation.py::test_the_readme"
TUTORIAL = "tests/end_to_end/test_documentation.py::test_the_tutorial"
NICENESS = 19  # of all that runs beside tests in real time; more than of live frame encoding (10)
REALTIME_FILES = pytest.StashKey[set[str]]()


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--accept", action="store_true", help="write the golden figures anew")


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    # before `-m` deselects: an unmarked test in a file of real-time tests runs in real time too
    marks = ("realtime", "browser")
    real_time = [i for i in items if any(i.get_closest_marker(m) for m in marks)]
    for item in real_time:  # a machine may be busy for a moment; a fault fails twice, and is listed
        item.add_marker(pytest.mark.flaky(reruns=1))
    files = {str(i.path) for i in real_time}
    config.stash[REALTIME_FILES] = files
    # at the head of the queue they share one worker; at the end, all workers would be left with
    # them, and with the longest, which cannot be shared; the two longest share what they make
    longest = (README, TUTORIAL)
    items.sort(key=lambda i: (not i.nodeid.startswith(longest), str(i.path) not in files))


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item: pytest.Item) -> Generator[None, object, object]:
    # only root may lower niceness again
    if "PYTEST_XDIST_WORKER" in os.environ and hasattr(os, "geteuid") and os.geteuid() == 0:
        real_time = str(item.path) in item.config.stash[REALTIME_FILES]
        os.setpriority(os.PRIO_PROCESS, 0, 0 if real_time else NICENESS)
    return (yield)
