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

import numpy as np
import pytest

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


def test_entries_take_nothing_but_what_they_are_declared_for() -> None:
    vectors = entry("rotation_vectors")
    for wrong in (np.eye(3, dtype=np.float32), np.asfortranarray(np.arange(9.0).reshape(3, 3))):
        with pytest.raises((TypeError, ValueError)):
            vectors(1, wrong, np.empty(3))


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
        for source in PACKAGE.rglob("*.py")
        for name in re.findall(r'\bentry\("(\w+)"\)', source.read_text())
    }
    assert declared == doors


def door_of(source: Path) -> ModuleType:
    """The module that calls what a source compiles."""
    door = source.parent / ("entries.py" if source.parent.name == "kernels" else "bundle.py")
    return import_module(".".join(door.relative_to(ROOT).with_suffix("").parts))


def test_no_source_has_a_warning_and_constants_that_python_shares_are_equal(tmp_path: Path) -> None:
    shared = 0
    for source in native.sources():
        words = set(
            re.findall(r"\b[A-Z]\w+\b", re.sub(r"/\*.*?\*/", "", source.read_text(), flags=re.S))
        )
        numbers = {k: v for k, v in vars(door_of(source)).items() if isinstance(v, int | float)}
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


@pytest.mark.long
def test_a_session_is_measured_within_its_own_memory(tmp_path: Path) -> None:
    compiler = shutil.which("gcc")
    if compiler is None:
        pytest.skip("gcc's library that watches memory")
    watched = [
        subprocess.check_output([compiler, f"-print-file-name={name}"], text=True).strip()
        for name in ("libasan.so", "libstdc++.so")  # what throws has to be there before
    ]
    watch = "-g", "-fsanitize=address,undefined", "-fno-sanitize-recover"
    native.build(tmp_path, (*FLAGS, *watch))
    command = (
        "run",
        str(ROOT / "sample_sessions" / "multi_joint_fault_6r"),
        "-o",
        str(tmp_path / "r"),
    )
    done = subprocess.run(
        [sys.executable, "-c", MEASURE_WATCHED, str(tmp_path), *command],
        env=os.environ | {"LD_PRELOAD": " ".join(watched), "ASAN_OPTIONS": "detect_leaks=0"},
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode in (0, 1), done.stderr[-3000:]
    assert "Sanitizer" not in done.stderr


def test_compiling_is_announced(caplog: pytest.LogCaptureFixture, tmp_path: Path) -> None:
    native.library_folder.cache_clear()
    with caplog.at_level(logging.INFO), pytest.MonkeyPatch.context() as changed:
        changed.setattr(native, "_folders", lambda: [tmp_path / "none"])
        changed.setattr(native, "build", lambda _folder: None)
        assert native.library_folder() == tmp_path / "none"
    native.library_folder.cache_clear()
    assert caplog.messages == [native.COMPILING]
