"""Is the robot where it says it is: flange pose from two cameras, compared with the encoders.

    from verify import analyse, open_session

    results = analyse(open_session("sample_sessions/multi_joint_fault_6r"))
    print(results.summary["diagnosis"])

`measure` is the chain alone: stereo pairs in, one measurement a pair out.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from verify.analysis.session import analyse
    from verify.core.version import __version__
    from verify.errors import InputError
    from verify.io.session.session import Session, open_session
    from verify.measurement.chain import Setup, measure

__all__ = ["InputError", "Session", "Setup", "__version__", "analyse", "measure", "open_session"]


# loaded when first asked for: the command line must answer --help at once
_MODULES = {
    "InputError": "verify.errors",
    "Session": "verify.io.session.session",
    "__version__": "verify.core.version",
    "Setup": "verify.measurement.chain",
    "analyse": "verify.analysis.session",
    "measure": "verify.measurement.chain",
    "open_session": "verify.io.session.session",
}


def __getattr__(name: str) -> Any:
    """Import a public name from its module."""
    if name not in _MODULES:
        raise AttributeError(f"module 'verify' has no attribute {name!r}")
    return getattr(import_module(_MODULES[name]), name)
