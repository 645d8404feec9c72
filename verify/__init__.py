"""Is the robot where it says it is: flange pose from two cameras, compared with the encoders.

    from verify import analyse, open_session

    results = analyse(open_session("sample_sessions/multi_joint_fault_6r"))
    print(results)         # the verdict in one sentence
    print(results.joints)  # a DataFrame, one row a joint

`open_results` takes up what `verify run` wrote. `measure` is the chain alone: stereo pairs in, one
measurement a pair out. Lengths are in metres, angles in radians, times in seconds; results carry
their unit in the name. What cannot be used raises `InputError`. docs/python.md has examples.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from verify.analysis.session import analyse
    from verify.core.records import Measurement
    from verify.core.version import __version__
    from verify.errors import InputError
    from verify.io.results import Results, open_results
    from verify.io.session.keys import Tolerance
    from verify.io.session.session import Session, open_session
    from verify.measurement.chain import Setup, measure

__all__ = [
    "InputError", "Measurement", "Results", "Session", "Setup", "Tolerance", "__version__",
    "analyse", "measure", "open_results", "open_session",
]  # fmt: skip


# loaded when first asked for: the command line must answer --help at once
_MODULES = {
    "InputError": "verify.errors",
    "Measurement": "verify.core.records",
    "Results": "verify.io.results",
    "Session": "verify.io.session.session",
    "Setup": "verify.measurement.chain",
    "Tolerance": "verify.io.session.keys",
    "__version__": "verify.core.version",
    "analyse": "verify.analysis.session",
    "measure": "verify.measurement.chain",
    "open_results": "verify.io.results",
    "open_session": "verify.io.session.session",
}


def __getattr__(name: str) -> Any:
    """Import a public name from its module."""
    if name not in _MODULES:
        raise AttributeError(f"module 'verify' has no attribute {name!r}")
    return getattr(import_module(_MODULES[name]), name)


def __dir__() -> list[str]:
    """List the public names, loaded or not, and what every module has."""
    return sorted({*__all__, *(name for name in globals() if name.startswith("__"))})
