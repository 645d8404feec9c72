"""Functions compiled to machine code, for loops over pixels that arrays are too slow for."""

import hashlib
import os
from collections.abc import Callable
from fnmatch import fnmatch
from pathlib import Path
from typing import TypeVar, cast

import numba

Function = TypeVar("Function", bound=Callable[..., object])
SOURCES = ("*kernel*.py", "compiled.py", "pose_prediction.py", "small_matrices.py")
QUICK_SUMS = {"reassoc", "contract", "nsz"}


def _kept() -> bool:
    """Whether machine code can be kept for the next time: beside the sources, or by the user.

    numba looks at a function's own file alone, but a function has others' code in it: so the code
    of all of them has a folder for each state of the sources.
    """
    if "NUMBA_CACHE_DIR" in os.environ:
        return True
    own = Path(__file__).parent
    users = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "verify"
    folder = (own / "__pycache__" if os.access(own, os.W_OK) else users) / f"kernels-{_state(own)}"
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError:
        return False
    vars(numba.config)["CACHE_DIR"] = str(folder)
    return os.access(folder, os.W_OK)


def _state(package: Path) -> str:
    """A name for the sources as they are, by when they were written and how long they are."""
    told = []
    for folder, inner, files in os.walk(package):
        inner[:] = [name for name in inner if name != "__pycache__"]  # thousands of kept files
        for name in files:
            if any(fnmatch(name, pattern) for pattern in SOURCES):
                state = Path(folder, name).stat()
                told.append((name, state.st_mtime_ns, state.st_size))
    return hashlib.sha256(repr(sorted(told)).encode()).hexdigest()[:12]


KEPT = _kept()


def compiled(function: Function) -> Function:
    """Compile a function when it is first called; the machine code is kept for the next time.

    Other threads run meanwhile: it must touch nothing but its arguments.
    """
    return cast("Function", numba.njit(function, cache=KEPT, nogil=True, error_model="numpy"))


def compiled_sums(function: Function) -> Function:
    """Compile likewise a function whose sums may be taken several terms at once: far quicker."""
    quick = numba.njit(function, cache=KEPT, nogil=True, error_model="numpy", fastmath=QUICK_SUMS)
    return cast("Function", quick)
