"""Compile functions to machine code, for loops that are too slow in numpy; keep that code on disk.

Whoever uses the package hears of the first compilation by the log, at level INFO: it takes a while.
"""

import hashlib
import logging
import mmap
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar, cast

import numba
from numba.core import event

COMPILING = "Compiling inner loops, once after an installation: up to a minute."
Function = TypeVar("Function", bound=Callable[..., object])
MAX_CODE_BYTES = 100_000_000  # that loading one function takes
FASTMATH_FLAGS = {"reassoc", "contract", "nsz"}


def compiled_sources(package: Path) -> list[Path]:
    """Files of compiled code in the package, sorted: `kernels…` in their path; and this one."""
    found = [Path("core/jit.py")]
    for folder, inner, files in os.walk(package):
        inner[:] = [name for name in inner if name != "__pycache__"]  # thousands of cached files
        place = Path(folder).relative_to(package)
        within = any(part.startswith("kernels") for part in place.parts)
        found += [place / f for f in files if f.endswith(".py") and (within or f == "kernels.py")]
    return sorted(found)


def _cache_available() -> bool:
    """Whether machine code can be kept: beside the sources, else in the user's cache folder.

    numba looks at a function's own file alone, but machine code holds that of the functions it
    calls: so each state of all the sources has a folder of its own.
    """
    if "NUMBA_CACHE_DIR" in os.environ:
        return True
    package = Path(__file__).parents[1]
    users = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "verify"
    parent = package / "__pycache__" if os.access(package, os.W_OK) else users
    folder = parent / f"kernels-{_source_fingerprint(package)}"
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError:
        return False
    vars(numba.config)["CACHE_DIR"] = str(folder)
    return os.access(folder, os.W_OK)


def _source_fingerprint(package: Path) -> str:
    """Hash paths, times of writing and lengths of the sources, 12 hexadecimal digits."""
    states = [(str(p), (package / p).stat()) for p in compiled_sources(package)]
    key = [(path, state.st_mtime_ns, state.st_size) for path, state in states]
    return hashlib.sha256(repr(key).encode()).hexdigest()[:12]


class _FirstCompilation(event.Listener):
    """Log that functions are compiled, before the first one is."""

    def on_start(self, _event: object) -> None:
        """Log it, once."""
        event.unregister("numba:compile", self)  # type: ignore[no-untyped-call]
        logging.getLogger(__name__).info(COMPILING)

    def on_end(self, _event: object) -> None:
        """Do nothing."""


class _MemoryCheck(event.Listener):
    """Raise ENOMEM before machine code is loaded: LLVM, for want of memory, ends the process."""

    def on_start(self, _event: object) -> None:
        """Ask for as much as loading takes, and give it back."""
        mmap.mmap(-1, MAX_CODE_BYTES).close()

    def on_end(self, _event: object) -> None:
        """Do nothing."""


def _cache_is_empty() -> bool:
    """Whether no machine code was kept yet for this state of the sources."""
    folder = Path(vars(numba.config)["CACHE_DIR"])
    return not (folder.is_dir() and any(folder.iterdir()))


CACHE = _cache_available()
if CACHE and _cache_is_empty():
    event.register("numba:compile", _FirstCompilation())  # type: ignore[no-untyped-call]
event.register("numba:compiler_lock", _MemoryCheck())  # type: ignore[no-untyped-call]
# level 3 takes a fifth longer to compile and is no quicker here; nothing calls from C
vars(numba.config)["OPT"] = type(vars(numba.config)["OPT"])(2)
OPTIONS: dict[str, Any] = {
    "cache": CACHE,
    "nogil": True,
    "error_model": "numpy",
    "no_cfunc_wrapper": True,
}


def compiled(function: Function) -> Function:
    """Compile a function at its first call; the machine code is kept for the next time.

    It runs without the interpreter's lock: it must touch nothing but its arguments.
    """
    return cast("Function", numba.njit(function, **OPTIONS))


def compiled_sums(function: Function) -> Function:
    """Compile as `compiled` does, with sums taken several terms at once: far quicker."""
    return cast("Function", numba.njit(function, fastmath=FASTMATH_FLAGS, **OPTIONS))
