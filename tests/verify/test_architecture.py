"""The rules of docs/architecture.md that import-linter does not check."""

import ast
import re
import tomllib
from collections import defaultdict
from importlib import metadata
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

PACKAGE = Path(__file__).parents[2] / "verify"
FACES = {"verify", "robots", "reports"}
MAX_LINES = 450
SMALL_MODULE = 80  # lines
MAX_SMALL_MODULES = 30
MAX_MODULES = 352


def modules() -> list[Path]:
    generated = PACKAGE / "__pycache__"
    found = (p for p in PACKAGE.rglob("*.py") if generated not in p.parents)
    return sorted(p for p in found if p.name != "__init__.py")


def test_no_module_is_loose_in_the_package() -> None:
    assert len(list(PACKAGE.glob("*.py"))) <= 4


def test_a_class_name_is_defined_once() -> None:
    places = defaultdict(list)
    for path in modules():
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ClassDef):
                places[node.name].append(path.relative_to(PACKAGE).as_posix())
    assert {name: found for name, found in places.items() if len(found) > 1} == {}


@pytest.mark.parametrize("package", ["verify", "robots", "reports", "tests/bench", "tests/support"])
def test_no_family_of_files_shares_a_first_word(package: str) -> None:
    families = []
    for folder in {p.parent for p in (PACKAGE.parent / package).rglob("*.py")}:
        words = defaultdict(list)
        for path in folder.glob("*.py"):
            words[path.stem.split("_")[0]].append(path.name)
        families += [
            sorted(names)
            for word, names in words.items()
            if word and len(names) > 1 and any("_" in name for name in names)
        ]
    assert families == []


@pytest.mark.parametrize("package", ["verify", "reports"])
def test_a_face_holds_a_docstring_and_nothing_else(package: str) -> None:
    root = PACKAGE.parent / package
    for path in root.rglob("__init__.py"):
        if path.parent.name in FACES:
            continue
        body = ast.parse(path.read_text(encoding="utf-8")).body
        assert len(body) == 1, path
        assert isinstance(body[0], ast.Expr), path


def test_modules_are_neither_too_long_nor_too_many_nor_too_small() -> None:
    lengths = {p.relative_to(PACKAGE): len(p.read_text().splitlines()) for p in modules()}
    assert {path: n for path, n in lengths.items() if n > MAX_LINES} == {}
    small = sorted(str(path) for path, n in lengths.items() if n < SMALL_MODULE)
    assert len(small) <= MAX_SMALL_MODULES, small
    assert len(lengths) <= MAX_MODULES


def test_no_source_in_c_is_too_long() -> None:
    lengths = {p.name: len(p.read_text().splitlines()) for p in PACKAGE.rglob("*.[ch]")}
    assert len(lengths) > 30
    assert {name: n for name, n in lengths.items() if n > MAX_LINES} == {}


def test_processes_are_started_in_one_module() -> None:
    importing = []
    for path in modules():
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            names = [a.name for a in node.names] if isinstance(node, ast.Import) else []
            names += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            if any(name.split(".")[0] == "multiprocessing" for name in names):
                importing.append(path.relative_to(PACKAGE).as_posix())
    assert set(importing) == {"core/processes.py"}


def test_test_modules_import_helpers_from_support_alone() -> None:
    tests = PACKAGE.parent / "tests"
    borrowed = []
    for path in tests.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("tests."):
                parts = (node.module or "").split(".")
                if parts[1] not in ("support", "bench", "fuzz"):
                    borrowed.append(f"{path.relative_to(tests)}: {node.module}")
    assert borrowed == []


def test_constraints_are_what_is_installed_and_every_requirement_has_an_upper_bound() -> None:
    root = PACKAGE.parent
    project = tomllib.loads((root / "pyproject.toml").read_text())["project"]
    stated = [Requirement(text) for text in project["dependencies"]]
    for extra in ("mqtt", "cluster", "opcua"):
        stated += [Requirement(text) for text in project["optional-dependencies"][extra]]
    assert [str(one) for one in stated if "<" not in str(one.specifier)] == []
    text = (root / ".ci" / "constraints.txt").read_text()
    pinned = {canonicalize_name(k): v for k, v in re.findall(r"(?m)^([\w.-]+)==(.+)$", text)}
    needed: dict[str, str] = {}
    while stated:
        one = stated.pop()
        name = canonicalize_name(one.name)
        if name not in needed and (one.marker is None or one.marker.evaluate({"extra": ""})):
            needed[name] = metadata.version(name)
            stated += map(Requirement, metadata.requires(name) or [])
    assert {name: pinned.get(name) for name in needed} == needed
