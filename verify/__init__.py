"""Is the robot where it says it is: flange pose from two cameras, compared with the encoders.

    from verify import analyse, open_session

    results = analyse(open_session("sample_sessions/multi_joint_fault_6r"))
    print(results.summary["diagnosis"])

`measure` is the chain alone: stereo pairs in, one measurement a pair out.
"""

from importlib import import_module
from importlib.metadata import PackageNotFoundError, version
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from verify.analysis import analyse
    from verify.errors import InputError
    from verify.measurement import Setup, measure
    from verify.session import Session, open_session

__all__ = ["InputError", "Session", "Setup", "analyse", "measure", "open_session"]

try:
    __version__ = version("verify-robot")
except PackageNotFoundError:  # run from a source tree that was never installed
    __version__ = "0+unknown"

# loaded when first asked for: the command line must answer --help at once
_HOMES = {
    "InputError": "verify.errors",
    "Session": "verify.session",
    "Setup": "verify.measurement",
    "analyse": "verify.analysis",
    "measure": "verify.measurement",
    "open_session": "verify.session",
}


def __getattr__(name: str) -> Any:
    """Import a public name from its module."""
    if name not in _HOMES:
        raise AttributeError(f"module 'verify' has no attribute {name!r}")
    return getattr(import_module(_HOMES[name]), name)
