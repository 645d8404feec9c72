import os

import pytest

# as the command line does, before numpy is first imported: small matrices want one thread
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--accept", action="store_true", help="write the golden figures anew")
