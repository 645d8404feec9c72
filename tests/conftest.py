import os
from collections.abc import Generator

import pytest

# as the command line does, before numpy is first imported: small matrices want one thread
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--accept", action="store_true", help="write the golden figures anew")


# these test what happens in real time: on few, slow cores what only computes has to wait for them
IN_REAL_TIME = tuple(
    f"tests/{place}"
    for place in (
        "end_to_end/test_watch.py",
        "end_to_end/test_grab",
        "verify/devices/",
        "verify/grab/",
        "verify/live/",
        "verify/page/",
        "verify/test_priority.py",
    )
)
LONGEST = "tests/end_to_end/test_documentation.py::test_the_readme"
# niceness: behind what paints a live run's pictures too, which itself stands back (10)
YIELDING = 19


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    # at the head of the queue they share one worker; at the end, all would be left with them, and
    # with the longest, which nobody can share
    items.sort(
        key=lambda i: (not i.nodeid.startswith(LONGEST), not i.nodeid.startswith(IN_REAL_TIME))
    )


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item: pytest.Item) -> Generator[None, object, object]:
    # only who may take niceness back can be nice for a while
    if "PYTEST_XDIST_WORKER" in os.environ and hasattr(os, "geteuid") and os.geteuid() == 0:
        niceness = 0 if item.nodeid.startswith(IN_REAL_TIME) else YIELDING
        os.setpriority(os.PRIO_PROCESS, 0, niceness)
    return (yield)
