"""Data beside the clone (../shared), which the CI has and users have not."""

from pathlib import Path

import pytest

SHARED = Path(__file__).resolve().parents[3] / "shared"


def shared(*parts: str) -> Path:
    """A file or folder of it.

    Without any ../shared the test is skipped. One that is there and lacks this part fails: a check
    that quietly stopped would pass for one that holds.
    """
    if not SHARED.is_dir():
        pytest.skip("needs ../shared beside the clone")
    found = SHARED.joinpath(*parts)
    assert found.exists(), f"../shared has no {'/'.join(parts)}"
    return found
