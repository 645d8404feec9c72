"""Functions compiled to machine code, for loops over pixels that arrays are too slow for."""

import os
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar, cast

import numba

Function = TypeVar("Function", bound=Callable[..., object])


def _keep_in(folder: Path) -> None:
    vars(numba.config)["CACHE_DIR"] = str(folder)


def _where_it_is_kept() -> None:
    """Let the machine code be kept where no folder beside the sources can be written."""
    if "NUMBA_CACHE_DIR" in os.environ or os.access(Path(__file__).parent, os.W_OK):
        return
    home = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    try:
        (home / "verify").mkdir(parents=True, exist_ok=True)
        _keep_in(home / "verify")
    except OSError:
        _keep_in(Path(tempfile.gettempdir()) / f"verify-{os.getuid()}")


_where_it_is_kept()


def compiled(function: Function) -> Function:
    """Compile a function when it is first called; the machine code is kept for the next time.

    Other threads run meanwhile: it must touch nothing but its arguments.
    """
    return cast("Function", numba.njit(function, cache=True, nogil=True, error_model="numpy"))


def compiled_sums(function: Function) -> Function:
    """Compile likewise a function whose sums may be taken several terms at once: far quicker."""
    quick = {"reassoc", "contract", "nsz"}
    return cast(
        "Function",
        numba.njit(function, cache=True, nogil=True, error_model="numpy", fastmath=quick),
    )
