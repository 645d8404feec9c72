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
from collections.abc import Callable, Sequence
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
ENTRY = r"^int64_t entry_(\w+)\([^)]*\)"  # a declaration
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
    """Write the module that tells cffi the entries, and what each of them only reads."""
    import cffi  # it loads a parser of C, which nothing but this needs

    found = (re.finditer(ENTRY, unit.read_text(), re.MULTILINE) for unit in units)
    declared = {one[1]: one[0] for matches in found for one in matches}
    maker = cffi.FFI()
    maker.cdef("\n".join(f"{one};" for one in declared.values()))
    maker.set_source(Path(INTERFACE).stem, None)
    maker.compile(str(folder))
    with (folder / INTERFACE).open("a", encoding="utf-8") as module:
        module.write(f"inputs = { {name: _inputs(one) for name, one in declared.items()} }\n")


def _inputs(declaration: str) -> dict[int, str]:
    """Which arguments are arrays that are only read, and of what kind, by numpy's name."""
    kinds = {name: kind for kind, name in TYPES.items()} | {"bool": "bool"}
    found = (re.match(r"\s*const (\w+) \*", one) for one in declaration.split("(")[1].split(","))
    return {n: kinds[one[1]] for n, one in enumerate(found) if one}


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
    """Load the library that a folder holds: the module of its interface, and the library."""
    spec = importlib.util.spec_from_file_location("verify_kernels", folder / INTERFACE)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module, module.ffi.dlopen(str(folder / LIBRARY))


@cache
def _library() -> tuple[Any, Any, Callable[[Sequence[Any]], list[Any]]]:
    """The interface, the library, and what makes values what entries take."""
    interface, functions = load(library_folder())
    pointer, kinds = interface.ffi.from_buffer, TYPES.items()
    types = {np.dtype(kind): interface.ffi.typeof(f"{name}[]") for kind, name in kinds}
    plain = np.ndarray  # told by their very type, which is quicker: a pair passes many

    def arguments(values: Sequence[Any]) -> list[Any]:
        return [pointer(types[v.dtype], v) if type(v) is plain else v for v in values]

    return interface, functions, arguments


def entry(name: str) -> Callable[..., int]:
    """A compiled entry, `entry_<name>` in C; it runs without the interpreter's lock.

    Returns:
        What calls it, with numbers and arrays as it is declared, and gives its result, an integer.
        An array that is only read, `const`, may be of any layout, and of a kind whose numbers the
        declared one holds; what is filled in has to be as declared and contiguous. It raises
        TypeError, KeyError or ValueError for others, MemoryError where the result is negative.
    """
    bound: list[Any] = []

    def call(*values: Any) -> int:
        if not bound:
            interface, functions, arguments = _library()
            bound[:] = getattr(functions, f"entry_{name}"), interface.inputs[name], arguments
        function, inputs, arguments = bound
        try:
            result: int = function(*arguments(values))
        except (KeyError, TypeError, ValueError):  # before it ran
            result = function(*arguments(_copied(values, inputs)))
        if result < 0:
            raise MemoryError
        return result

    return call


def _copied(values: Sequence[Any], inputs: dict[int, str]) -> list[Any]:
    """Copy arrays that are only read to what is declared."""
    return [
        v.astype(inputs[n], order="C", casting="same_kind", subok=False)
        if n in inputs and isinstance(v, np.ndarray)
        else v
        for n, v in enumerate(values)
    ]
