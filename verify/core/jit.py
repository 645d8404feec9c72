"""Compile functions to machine code, for loops that are too slow in numpy; keep that code on disk.

Whoever uses the package hears of the first compilation by the log, at level INFO: it takes a while.
"""

import hashlib
import logging
import mmap
import os
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any, TypeVar, cast

import numba
from numba.core import codegen, event, types
from numba.core.compiler import Compiler
from numba.core.registry import CPUDispatcher

COMPILING = "Compiling inner loops, once after an installation: a minute or two."
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
        announce_compilation()

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
FIRST_USE = CACHE and _cache_is_empty()


@cache
def announce_compilation() -> None:
    """Log, once, that functions are compiled, at first use; for who has a child process do it."""
    if FIRST_USE:
        logging.getLogger(__name__).info(COMPILING)


if FIRST_USE:
    event.register("numba:compile", _FirstCompilation())  # type: ignore[no-untyped-call]
event.register("numba:compiler_lock", _MemoryCheck())  # type: ignore[no-untyped-call]
# the release for whose inside the classes below are made; any other compiles its own way
KNOWN_NUMBA = numba.__version__.startswith("0.68.")
# level 3 takes a fifth longer to compile and is no quicker here; nothing calls from C
vars(numba.config)["OPT"] = type(vars(numba.config)["OPT"])(2)
OPTIONS: dict[str, Any] = {
    "nogil": True,
    "error_model": "numpy",
    "no_cfunc_wrapper": True,
}


class _Library(codegen.JITCodeLibrary):
    """Code that is optimised and made machine code once its address is asked for.

    numba does so at once, and anew with all callers: what they alone call is done there and once.
    """

    _deferred = False

    def _optimize_final_module(self) -> None:
        """Leave it to callers, or until then."""
        self._deferred = True  # what comes from disk is not optimised

    def _finalize_final_module(self) -> None:
        if self._deferred:
            self._finalize_dynamic_globals()  # type: ignore[no-untyped-call]
            self._finalized = True
        else:
            super()._finalize_final_module()  # type: ignore[no-untyped-call]

    def get_pointer_to_function(self, name: str) -> int:
        """Give a function's address; 0 where there is none of this name."""
        self._ensure_finalized()  # type: ignore[no-untyped-call]
        if self._deferred and any(f.name == name for f in self._final_module.functions):
            self._deferred = False
            super()._optimize_final_module()  # type: ignore[no-untyped-call]
            super()._finalize_final_module()  # type: ignore[no-untyped-call]
        address: int = super().get_pointer_to_function(name)  # type: ignore[no-untyped-call]
        return address


class _Codegen(codegen.JITCPUCodegen):
    """Makes such libraries; what is not in memory has no environment."""

    _library_class = _Library

    def set_env(self, env_name: str, env: object) -> None:
        """Tell a function its constants."""
        if self._engine.is_symbol_defined(env_name):  # type: ignore[no-untyped-call]
            super().set_env(env_name, env)  # type: ignore[no-untyped-call]


class _Inner(Compiler):
    """Compiles without the wrapper for Python, which is longer than most functions."""

    def define_pipelines(self) -> list[Any]:
        """Change what is made, not the key by which numba finds its own functions again."""
        self.state.flags.no_cpython_wrapper = True
        pipelines: list[Any] = super().define_pipelines()  # type: ignore[no-untyped-call]
        return pipelines


class _Twin(CPUDispatcher):
    """A compiled function as others call it: once for all constants that it is called with."""

    def get_call_template(self, args: Any, kws: Any) -> Any:
        """Type a call by the kind of its constants, not by their values."""
        kinds = {name: types.unliteral(kind) for name, kind in kws.items()}  # type: ignore[no-untyped-call]
        return super().get_call_template([types.unliteral(kind) for kind in args], kinds)  # type: ignore[no-untyped-call]


class _Kernel(CPUDispatcher):
    """A compiled function; others that call it take its twin `inner` in."""

    inner: Any

    @property
    def _numba_type_(self) -> types.Dispatcher:
        return types.Dispatcher(self.inner)


def _compiled(function: Function, **options: Any) -> Function:
    options |= OPTIONS
    if not KNOWN_NUMBA:
        return cast("Function", numba.njit(function, cache=CACHE, **options))
    options["nopython"] = True
    kernel = _Kernel(function, targetoptions=options)
    kernel.inner = _Twin(function, targetoptions=options, pipeline_class=_Inner)
    if CACHE:
        kernel.enable_caching()
    return cast("Function", kernel)


_operators: dict[Any, Any] = {}
_type_call = types.Function.get_call_type


def _type_operator(function: Any, context: Any, args: tuple[Any, ...], kws: Any) -> Any:
    """Type an operator of numbers and arrays once: numba tries twenty ways at every use."""
    known = (types.Number, types.Boolean, types.Array, types.BaseTuple)
    if getattr(function.typing_key, "__module__", "") != "_operator" or not all(
        isinstance(a, known) for a in args
    ):
        return _type_call(function, context, args, kws)
    key = function, tuple(args)
    if key not in _operators:
        _operators[key] = _type_call(function, context, args, kws)
    return _operators[key]


if KNOWN_NUMBA:
    vars(codegen)["JITCPUCodegen"] = _Codegen
    types.Function.get_call_type = _type_operator  # type: ignore[assignment,method-assign]


def compiled(function: Function) -> Function:
    """Compile a function at its first call; the machine code is kept for the next time.

    It runs without the interpreter's lock: it must touch nothing but its arguments.
    """
    return _compiled(function)


def compiled_sums(function: Function) -> Function:
    """Compile as `compiled` does, with sums taken several terms at once: far quicker."""
    return _compiled(function, fastmath=FASTMATH_FLAGS)
