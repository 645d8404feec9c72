"""Functions compiled to machine code, for loops over pixels that arrays are too slow for."""

import os
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar, cast

import numba

Function = TypeVar("Function", bound=Callable[..., object])
QUICK_SUMS = {"reassoc", "contract", "nsz"}


def _kept() -> bool:
    """Whether machine code can be kept for the next time: beside the sources, or by the user."""
    if "NUMBA_CACHE_DIR" in os.environ or os.access(Path(__file__).parent, os.W_OK):
        return True
    folder = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "verify"
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError:
        return False
    vars(numba.config)["CACHE_DIR"] = str(folder)
    return os.access(folder, os.W_OK)


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
