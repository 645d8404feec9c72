"""Where compiled inner loops are kept, what is said where none can be made, and their memory."""

import logging
import os
import re
import shutil
import subprocess
import sys
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from tests.support import kernels
from verify.core import native
from verify.core.native import FLAGS, INTERFACE, LIBRARY, PACKAGE, entry
from verify.errors import InputError

ROOT = Path(__file__).parents[3]
# the package's own folder as of a user who may not write there
REPORT_FOLDER = """
import importlib.util, logging, os, pathlib
import numpy as np
logging.basicConfig(level=logging.INFO)
may, own = os.access, str(pathlib.Path(importlib.util.find_spec("verify").origin).parent)
os.access = lambda path, mode: str(path) != own and may(path, mode)
from verify.core.native import library_folder
from verify.core.kernels.entries import rotation_vectors
found = np.empty((1, 3))
rotation_vectors(np.diag([1.0, -1.0, -1.0])[None], found)
print(library_folder(), round(found[0, 0], 6))
"""
# with addresses and undefined behaviour watched by the compiler's own libraries
MEASURE_WATCHED = """
import sys
from pathlib import Path
from verify.core import native
native.library_folder = lambda: Path(sys.argv[1])
from verify.cli.main import main
main([*sys.argv[2:]])
"""


def folder_report(cache: Path) -> tuple[Path, str, bool]:
    """Where the library is, what was computed, and whether compiling was announced."""
    done = subprocess.run(
        [sys.executable, "-c", REPORT_FOLDER],
        env=os.environ | {"XDG_CACHE_HOME": str(cache)},
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    folder, value = done.stdout.split()
    return Path(folder), value, native.COMPILING in done.stderr


@pytest.mark.slow
def test_where_the_package_cannot_be_written_the_user_s_cache_serves(tmp_path: Path) -> None:
    folder, value, announced = folder_report(tmp_path)
    assert (folder.parent, value, announced) == (tmp_path / "verify", "3.141593", True)
    assert sorted(p.name for p in folder.iterdir() if p.is_file()) == [INTERFACE, LIBRARY]
    assert folder_report(tmp_path) == (folder, "3.141593", False)


@pytest.mark.slow
def test_what_cannot_be_kept_is_compiled_all_the_same(tmp_path: Path) -> None:
    (tmp_path / "cache").write_text("in the way")
    folder, value, _ = folder_report(tmp_path / "cache")
    assert value == "3.141593"
    assert not folder.exists()


@pytest.mark.parametrize(
    ("environment", "said"),
    [
        ({"CC": "", "PATH": ""}, "none of cc, gcc, clang is on the PATH"),
        ({"CC": f"{sys.executable} -c import=this"}, "does not compile the inner loops"),
        ({"CC": "no-such-compiler"}, "no-such-compiler"),
    ],
)
def test_without_a_compiler_one_line_says_what_to_do(
    environment: dict[str, str], said: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    for name, value in environment.items():
        monkeypatch.setenv(name, value)
    monkeypatch.setattr(native.importlib.util, "find_spec", lambda _name: None)
    with pytest.raises(InputError, match=said) as raised:
        native.build(tmp_path)
    assert "\n" not in str(raised.value)
    assert list(tmp_path.iterdir()) == []


def strided(array: NDArray[Any]) -> NDArray[Any]:
    """The same numbers, not one behind the other."""
    return np.repeat(array, 2, axis=-1)[..., ::2]


def test_what_an_entry_reads_may_be_of_any_layout_and_what_it_fills_may_not() -> None:
    turns = Rotation.from_rotvec([[0.1, -0.2, 0.3], [0.4, 0.0, -0.5]]).as_matrix()
    vectors, found = entry("rotation_vectors"), np.empty((2, 3))
    foreign = turns.astype(">f8"), turns.view(np.memmap)  # another byte order, another class
    for kind in (strided(turns), np.asfortranarray(turns), turns.astype(np.float32), *foreign):
        found[:] = np.nan
        vectors(2, kind, found)
        np.testing.assert_allclose(found, [[0.1, -0.2, 0.3], [0.4, 0.0, -0.5]], atol=1e-6)
    for wrong in (strided(found), found.astype(np.float32), found.astype(np.complex128)):
        with pytest.raises((KeyError, TypeError, ValueError)):
            vectors(2, turns, wrong)
    with pytest.raises(TypeError):
        vectors(2, turns.astype(np.complex128), found)


def test_every_source_is_compiled() -> None:
    assert set(native.sources()) == set(PACKAGE.rglob("*.[ch]"))


def test_every_entry_has_a_door_and_every_door_an_entry() -> None:
    declared = {
        name
        for source in native.sources()
        for name in re.findall(r"^int64_t entry_(\w+)\(", source.read_text(), re.MULTILINE)
    }
    doors = {
        name
        for source in (*PACKAGE.rglob("*.py"), ROOT / "tests" / "support" / "kernels.py")
        for name in re.findall(r'\bentry\("(\w+)"\)', source.read_text())
    }
    assert declared == doors


def door_of(source: Path) -> ModuleType:
    """The module that calls what a source compiles."""
    beside = source.parent
    own = beside / "entries.py", beside.parent / "find.py", beside / "bundle.py"
    door = next(path for path in own if path.exists())
    return import_module(".".join(door.relative_to(ROOT).with_suffix("").parts))


def test_no_source_has_a_warning_and_constants_that_python_shares_are_equal(tmp_path: Path) -> None:
    shared = 0
    for source in native.sources():
        words = set(
            re.findall(r"\b[A-Z]\w+\b", re.sub(r"/\*.*?\*/", "", source.read_text(), flags=re.S))
        )
        constants = vars(kernels) | vars(door_of(source))
        numbers = {k: v for k, v in constants.items() if isinstance(v, int | float)}
        checks = [
            f'_Static_assert(({n}) - ({numbers[n]}) < 1e-7, "{n}");\n'
            f'_Static_assert(({n}) - ({numbers[n]}) > -1e-7, "{n}");'
            for n in sorted(words & numbers.keys())
        ]
        unit = tmp_path / "unit.c"
        unit.write_text("\n".join([f'#include "{source}"', *checks, ""]))
        strict = f"-I{ROOT}", "-Wall", "-Wextra", "-Werror", "-fsyntax-only"
        subprocess.run([*native.compiler(), *FLAGS, *strict, str(unit)], check=True)
        shared += len(checks)
    assert shared > 50


def run_watched(folder: Path, code: str, *words: str) -> subprocess.CompletedProcess[str]:
    """Run Python with a library whose memory and arithmetic the compiler watches: 99 at a fault."""
    native.build(folder, (*FLAGS, "-g", "-fsanitize=address,undefined", "-fno-sanitize-recover"))
    watching = [
        subprocess.check_output(["gcc", f"-print-file-name={name}"], text=True).strip()
        for name in ("libasan.so", "libstdc++.so.6")  # what throws has to be there before
    ]
    watched = {
        "LD_PRELOAD": " ".join(watching),
        "ASAN_OPTIONS": "detect_leaks=0:exitcode=99",
        "UBSAN_OPTIONS": "exitcode=99",
    }
    return subprocess.run(
        [sys.executable, "-c", code, str(folder), *words], env=os.environ | watched,
        capture_output=True, text=True, check=False,
    )  # fmt: skip


@pytest.fixture
def with_gcc(monkeypatch: pytest.MonkeyPatch) -> None:
    """The compiler whose libraries watch memory; .ci/run installs it, or ends."""
    if shutil.which("gcc") is None:
        pytest.skip("needs gcc, whose libraries watch memory and arithmetic")
    monkeypatch.setenv("CC", "gcc")


@pytest.mark.slow
@pytest.mark.usefixtures("with_gcc")
def test_a_session_is_measured_within_its_own_memory(tmp_path: Path) -> None:
    words = "run", str(ROOT / "sample_sessions" / "multi_joint_fault_6r"), "-o", str(tmp_path / "r")
    done = run_watched(tmp_path, MEASURE_WATCHED, *words)
    assert done.returncode == 1, done.stderr[-3000:]  # joints are outside the tolerance
    assert (tmp_path / "r" / "summary.json").exists()


FAULTS = """
#include "verify/core/kernels/scratch.h"

static int64_t use(int64_t n)
{
    Mark mark = scratch_mark();
    int64_t *first = TAKE(int64_t, n), *second = TAKE(int64_t, n);
    for (int64_t k = 0; k < n; k++)
        first[k] = second[k] = k;
    int64_t *last = n > 3 ? first + n : first + n - 1;  /* behind the end */
    *last = second[0];
    int64_t sum = first[0] + second[n - 1] + (n == 3 ? INT64_MAX : 0);  /* too large */
    scratch_release(mark);
    return sum > 0;
}

int64_t entry_use(int64_t n)
{
    GUARDED(use(n));
}
"""
USE_WATCHED = """
import sys
from pathlib import Path
from verify.core import native
native.library_folder = lambda: Path(sys.argv[1])
native.entry("use")(int(sys.argv[2]))
"""


@pytest.mark.slow
@pytest.mark.usefixtures("with_gcc")
@pytest.mark.parametrize(("size", "status"), [(2, 0), (3, 99), (4, 99)])
def test_such_a_library_finds_a_fault(
    size: int, status: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "use.c").write_text(FAULTS)
    kernels = PACKAGE / "core" / "kernels"
    own = [tmp_path / "use.c", kernels / "scratch.c"]
    monkeypatch.setattr(native, "sources", lambda: own)
    done = run_watched(tmp_path, USE_WATCHED, str(size))
    assert done.returncode == status, done.stderr[-3000:]


def test_compiling_is_announced(caplog: pytest.LogCaptureFixture, tmp_path: Path) -> None:
    native.library_folder.cache_clear()
    with caplog.at_level(logging.INFO), pytest.MonkeyPatch.context() as changed:
        changed.setattr(native, "_folders", lambda: [tmp_path / "none"])
        changed.setattr(native, "build", lambda _folder: None)
        assert native.library_folder() == tmp_path / "none"
    native.library_folder.cache_clear()
    assert caplog.messages == [native.COMPILING]
