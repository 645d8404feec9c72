"""Compile the inner loops, written in C beside the packages that they serve, and call them.

The library is kept beside the sources, else in the user's cache folder, for each state of the
sources, of the flags and of the processor.
"""

import hashlib
import importlib.util
import logging
import os
import platform
import re
import shlex
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from verify.errors import InputError

COMPILING = "Compiling inner loops, once after an installation: some seconds."
COMPILERS = ("cc", "gcc", "clang")
FLAGS = (
    "-std=c11", "-O3", "-march=native", "-fPIC", "-fopenmp-simd", "-ffp-contract=fast",
    "-fno-math-errno", "-fno-trapping-math", "-fno-semantic-interposition",
)  # fmt: skip
PACKAGE = Path(__file__).parents[1]
FOLDERS = (
    "core/kernels", "measurement/kernels", "measurement/detection/kernels",
    "measurement/correspondence/kernels", "calibration/corners/kernels", "calibration/stereo",
)  # fmt: skip
LIBRARY = "kernels.dll" if sys.platform == "win32" else "kernels.so"
INTERFACE = "interface.py"  # what cffi makes of the entries' declarations, beside the library
ENTRY = r"^int64_t entry_\w+\([^)]*\)"  # a declaration
TYPES = {"float64": "double", "float32": "float", "bool": "_Bool"} | {
    whole: f"{whole}_t" for whole in ("int64", "int32", "uint8", "int8")
}


def sources(package: Path = PACKAGE) -> list[Path]:
    """Files of C in the package, headers too, sorted."""
    return sorted(p for folder in FOLDERS for p in (package / folder).glob("*.[ch]"))


@cache
def library_folder() -> Path:
    """Give the folder that holds the library and its interface, compiled first if need be.

    The log tells of it, at level INFO.

    Raises:
        InputError: there is no compiler, or it fails.
    """
    folders = _folders()
    for folder in folders:
        if (folder / LIBRARY).exists():
            return folder
    logging.getLogger(__name__).info(COMPILING)
    for folder in folders:
        try:
            folder.mkdir(parents=True, exist_ok=True)
            build(folder)
        except OSError:
            continue
        return folder
    place = tempfile.TemporaryDirectory(ignore_cleanup_errors=True)
    _kept.append(place)
    build(Path(place.name))
    return Path(place.name)


_kept: list[tempfile.TemporaryDirectory[str]] = []  # until the process ends


def _folders() -> list[Path]:
    """Where the library may be kept, the best place first."""
    users = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "verify"
    entries = (entry for folder in FOLDERS for entry in os.scandir(PACKAGE / folder))
    own = sorted((e.path, e.stat()) for e in entries if e.name.endswith((".c", ".h")))
    states = [(path, state.st_mtime_ns, state.st_size) for path, state in own]
    key = states, FLAGS, os.environ.get("CC"), _processor()
    name = f"kernels-{hashlib.sha256(repr(key).encode()).hexdigest()[:12]}"
    beside = [PACKAGE / "__pycache__" / name] if os.access(PACKAGE, os.W_OK) else []
    return [*beside, users / name]


def _processor() -> str:
    """What the processor can do: machine code of another one may not run here."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return f"{platform.machine()} {platform.processor()}"
    return next((x for x in lines if x.startswith(("flags", "Features"))), platform.machine())


def compiler() -> list[str]:
    """Command of a C compiler.

    Raises:
        InputError: there is none.
    """
    if os.environ.get("CC"):
        return shlex.split(os.environ["CC"])
    for name in COMPILERS:
        if found := shutil.which(name):
            return [found]
    if importlib.util.find_spec("ziglang"):
        return [sys.executable, "-m", "ziglang", "cc"]
    raise InputError(
        "C compiler",
        f"none of {', '.join(COMPILERS)} is on the PATH",
        "one compiles the inner loops at first use",
        "Install one, or the Python package ziglang, which brings one along.",
    )


def build(folder: Path, flags: tuple[str, ...] = FLAGS) -> None:
    """Compile the sources to a shared library in a folder, two files at a time."""
    command, inside = [*compiler(), *flags], f"-I{PACKAGE.parent}"
    units = [source for source in sources() if source.suffix == ".c"]
    with tempfile.TemporaryDirectory(dir=folder) as place, ThreadPoolExecutor(2) as pool:
        objects = [str(Path(place) / f"{n}.o") for n in range(len(units))]
        jobs = [
            pool.submit(_run, [*command, inside, "-c", str(unit), "-o", made])
            for unit, made in zip(units, objects, strict=True)
        ]
        _write_interface(units, Path(place))
        for job in jobs:
            job.result()
        _run([*command, "-shared", *objects, "-lm", "-o", str(Path(place) / LIBRARY)])
        for name in (INTERFACE, LIBRARY):  # the library last: it says that all is there
            (Path(place) / name).replace(folder / name)


def _write_interface(units: list[Path], folder: Path) -> None:
    """Write the module that tells cffi the entries, as the sources declare them."""
    import cffi  # it loads a parser of C, which nothing but this needs

    declared = [x for unit in units for x in re.findall(ENTRY, unit.read_text(), re.MULTILINE)]
    maker = cffi.FFI()
    maker.cdef("\n".join(f"{one};" for one in declared))
    maker.set_source(Path(INTERFACE).stem, None)
    maker.compile(str(folder))


def _run(command: list[str]) -> None:
    try:
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        wrong = (done.stderr.strip() or f"status {done.returncode}") if done.returncode else ""
    except OSError as error:
        wrong = str(error)
    if wrong:
        raise InputError(
            command[0],
            f"it does not compile the inner loops: {wrong}",
            "a C11 compiler",
            "Name another one in the environment variable CC.",
        )


def load(folder: Path) -> tuple[Any, Any]:
    """Load the library that a folder holds: cffi's interface, and the library."""
    spec = importlib.util.spec_from_file_location("verify_kernels", folder / INTERFACE)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.ffi, module.ffi.dlopen(str(folder / LIBRARY))


@cache
def library() -> tuple[Any, Any, dict[Any, Any]]:
    """Cffi's interface, the library, and cffi's type of an array by numpy's letter."""
    interface, functions = load(library_folder())
    types = {np.dtype(kind).char: interface.typeof(f"{name}[]") for kind, name in TYPES.items()}
    return interface, functions, types


def entry(name: str) -> Callable[..., int]:
    """A compiled entry, `entry_<name>` in C; it runs without the interpreter's lock.

    Returns:
        What calls it, with numbers and contiguous arrays as it is declared, and gives its result,
        an integer. It raises TypeError or ValueError for other arrays, MemoryError where the result
        is negative.
    """
    bound: list[Any] = []

    def call(*values: Any) -> int:
        if not bound:
            interface, functions, types = library()
            bound[:] = getattr(functions, f"entry_{name}"), interface.from_buffer, types
        function, pointer, types = bound
        result: int = function(
            *[pointer(types[v.dtype.char], v) if isinstance(v, np.ndarray) else v for v in values]
        )
        if result < 0:
            raise MemoryError
        return result

    return call
