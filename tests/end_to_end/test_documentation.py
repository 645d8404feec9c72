"""The documents are true: commands run, files exist, options and keys are known."""

import contextlib
import json
import os
import re
import shlex
import shutil
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pandas as pd
import pytest

import robots
from tests.support import commands
from tests.support.command import ROOT, sample_results, verify
from tests.support.pictures import first_page, gallery, notebook, stamp
from verify.cli.main import app
from verify.io import fiducials, rig
from verify.io.session import keys as session_keys
from verify.simulation import library

README = ROOT / "README.md"
INDEX, TUTORIAL, PYTHON, DEVELOPMENT = (
    ROOT / "docs" / f"{name}.md" for name in ("index", "tutorial", "python", "development")
)
DOCUMENTS = sorted([README, ROOT / "CHANGELOG.md", *(ROOT / "docs").glob("*.md")])
GROUPS = {
    str(group.name): group.typer_instance
    for group in app.registered_groups
    if group.typer_instance is not None
}
COMMANDS = sorted(
    f"{group} {c.callback.__name__}".strip()
    for group, commands in {"": app, **GROUPS}.items()
    for c in commands.registered_commands
    if c.callback
)
EVERYWHERE = {"--help", "--version", "--quiet", "--verbose", "--json", "--open"}
SHELL = re.compile(r"[|&;<>$`*~\\(]")  # what a shell reads otherwise than shlex does
# dear, the same in the index and in the tutorial, and of nothing that came before but each other
SHARED = (
    "verify simulate boards_turning -o my_boards",
    "verify calibrate boards my_boards -o rig.toml",
)
SETS_UP = ("make", "python3 -m venv", ".venv/bin/pip", ".venv/bin/python -m pytest")
MAX_README_LINES = 110
SITE = ROOT / ".ci" / "mkdocs.yml"
OURS = {"README.md", "LICENSE", "Makefile", "CHANGELOG.md", "pyproject.toml"}
each_document = pytest.mark.parametrize("document", DOCUMENTS, ids=lambda d: str(d.name))


def blocks(document: Path, language: str) -> list[str]:
    fence = rf"^```{language}\n(.*?)^```$"
    return re.findall(fence, document.read_text(), flags=re.MULTILINE | re.DOTALL)


def lines(document: Path) -> Iterator[str]:
    for block in blocks(document, "sh"):
        yield from (line for line in block.splitlines() if line.strip())


@pytest.fixture
def clone(tmp_path: Path) -> Path:
    """A folder that looks like a fresh clone with its environment; what commands write stays."""
    folder = tmp_path / "clone"
    folder.mkdir()
    for name in ("sample_sessions", ".ci", "docs", "pyproject.toml", "Makefile"):
        (folder / name).symlink_to(ROOT / name)
    (folder / ".venv").mkdir()
    (folder / ".venv" / "bin").symlink_to(Path(sys.executable).parent)
    return folder


@pytest.fixture(scope="session")
def shared(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What the commands of SHARED have written: a folder a command."""
    return tmp_path_factory.mktemp("shared")


def run(words: list[str], folder: Path) -> subprocess.CompletedProcess[str]:
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    here = {**os.environ, "PATH": path, "PYTHONPATH": str(ROOT)}
    return subprocess.run(words, cwd=folder, env=here, capture_output=True, text=True, check=False)


@pytest.mark.slow
def test_the_readme_runs_as_written_and_its_output_is_explained(clone: Path, shared: Path) -> None:
    """One test: processes that share the tests would each run the commands, which takes minutes."""
    every_command_runs(README, clone, shared)
    assert every_command_runs(INDEX, clone, shared) >= len(COMMANDS)
    every_python_example_runs(clone)
    every_key_column_and_file_is_explained(clone)


@pytest.mark.slow
def test_the_tutorial_runs_from_an_empty_folder_to_a_report(tmp_path: Path, shared: Path) -> None:
    assert every_command_runs(TUTORIAL, tmp_path, shared)
    found = json.loads((tmp_path / "first-report" / "summary.json").read_text())
    assert found["joints"][1]["mean_error_deg"] == pytest.approx(0.35, abs=0.01)  # simulated


def every_command_runs(document: Path, folder: Path, shared: Path) -> int:
    """All but those that set up, as written, in their order; returns how many."""
    typed = [line for line in lines(document) if not line.startswith(SETS_UP)]
    for line in typed:
        stated = re.search(r"# status (\d+)", line)
        status, message = (typed_once if line in SHARED else type_in)(line, folder, shared)
        assert status == (int(stated[1]) if stated else 0), f"{line}\n{message}"
    return len(typed)


def type_in(line: str, folder: Path, _shared: Path) -> tuple[int, str]:
    """Run a line; status and standard error. `verify …` runs in this process, loaded once."""
    words = shlex.split(line, comments=True)
    if words[0] != "verify" or SHELL.search(line.partition("#")[0]):
        done = run(["bash", "-c", line], folder)
        return done.returncode, done.stderr
    with contextlib.chdir(folder):
        outcome = verify(*words[1:])
    return outcome.status, outcome.err


def typed_once(line: str, folder: Path, shared: Path) -> tuple[int, str]:
    """Run a line of SHARED, or give what it wrote and said when it ran for the other document."""
    kept = shared / str(SHARED.index(line))
    said = kept.with_suffix(".json")
    if not said.exists():
        before = set(folder.iterdir())
        outcome = type_in(line, folder, shared)
        kept.mkdir()
        for path in set(folder.iterdir()) - before:
            (shutil.copytree if path.is_dir() else shutil.copy)(path, kept / path.name)
        said.write_text(json.dumps(outcome))
    else:
        shutil.copytree(kept, folder, dirs_exist_ok=True)
    status, message = json.loads(said.read_text())
    return status, message


def every_python_example_runs(clone: Path) -> None:
    for code in (*blocks(README, "python"), "\n".join(blocks(PYTHON, "python"))):
        done = run([sys.executable, "-W", "error", "-c", code], clone)
        assert done.returncode == 0, done.stderr
        assert done.stdout.strip()


def test_installation_names_every_target_and_existing_files_and_extras() -> None:
    phony = re.search(r"^\.PHONY: (.*)$", (ROOT / "Makefile").read_text(), flags=re.MULTILINE)
    targets = phony[1].split()
    assert [name for name in targets if f"make {name}" not in DEVELOPMENT.read_text()] == []
    assert len(README.read_text().splitlines()) <= MAX_README_LINES
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    extras = project["optional-dependencies"]
    for document in DOCUMENTS:
        named = re.findall(r"(?:^|`)make ([a-z-]+)", document.read_text(), flags=re.MULTILINE)
        assert set(named) <= set(targets), document.name
    for line in (*lines(README), *lines(DEVELOPMENT)):
        words = shlex.split(line, comments=True)
        if words[0] == ".venv/bin/pip":
            assert (ROOT / words[words.index("-c") + 1]).is_file()
            wanted = re.search(r"\[(.*)\]", words[words.index("-e") + 1])
            assert wanted is None or wanted[1] in extras


def test_robots_lists_every_arm_and_checks_one() -> None:
    listed = verify("robots")
    assert [line.split()[0] for line in listed.out.splitlines()] == list(robots.names())
    checked = verify("robots", "iust_6r", "--poses", "20")
    assert (listed.status, checked.status) == (0, 0)


def test_the_page_of_commands_is_what_they_say_of_themselves() -> None:
    assert set(commands.COMMANDS) == set(COMMANDS)
    assert commands.PAGE.read_text() == commands.page(), "python -m tests.support.commands"


def test_every_picture_is_of_this_version_and_shown() -> None:
    shown = {
        (document.parent / link).resolve()
        for document in DOCUMENTS
        for link in re.findall(r"!\[[^]]+\]\(([^)]+)\)", document.read_text())
    }
    assert shown == set((ROOT / "docs").rglob("*.png"))
    assert {path.name: stamp.read(path)[stamp.SOFTWARE] for path in shown} == {
        path.name: stamp.MAKER for path in shown
    }, "make pictures"
    gallery_bytes = sum(path.stat().st_size for path in shown if path.name.startswith("gallery"))
    assert gallery_bytes < 1.5e6
    assert gallery.PAGE.read_text() == gallery.page(), "make pictures"
    assert gallery.PAGE.read_text().count("![") == len(gallery.GALLERY), "make pictures"


def test_the_picture_of_the_report_says_what_the_report_says() -> None:
    now = stamp.digest(first_page.document(sample_results("multi_joint_fault_6r")))
    kept = stamp.read(stamp.FOLDER / "report.png")[stamp.SOURCE]
    assert kept == now, "make pictures"


def test_every_document_is_a_page_of_the_site() -> None:
    named = re.findall(r": ([\w-]+\.md)$", SITE.read_text(), flags=re.MULTILINE)
    pages = [path.name for path in (ROOT / "docs").glob("*.md")]
    assert sorted(named) == sorted([*pages, "notebook.md"])


@pytest.mark.slow
def test_the_site_builds_without_a_warning(tmp_path: Path) -> None:
    words = [sys.executable, "-m", "mkdocs", "build", "--strict", "-f", str(SITE), "-d"]
    done = run([*words, str(tmp_path / "site")], ROOT)
    assert done.returncode == 0, done.stderr
    page = (tmp_path / "site" / "notebook.html").read_text()
    assert "The robot does not conform" in page
    assert "data:image/png;base64," in page


@pytest.mark.slow
@pytest.mark.long
def test_the_notebook_prints_what_it_shows() -> None:
    kept = notebook.PAGE.read_text()
    assert len(kept.encode()) < 500_000
    assert notebook.texts(notebook.executed()) == notebook.texts(kept), "make pictures"
    assert json.loads(kept)["metadata"]["verify"] == stamp.MAKER


@cache
def options(command: str) -> set[str]:
    """Long options by --help, but those of every command, and --out, which is shown as -o."""
    message = verify(*command.split(), "--help").out
    return set(re.findall(r"--[a-z-]+", message)) - EVERYWHERE - {"--out"}


@each_document
def test_every_command_and_option_named_exists(document: Path) -> None:
    text = document.read_text()
    typed = re.findall(r"^(?:\.venv/bin/)?(verify .*)$|`(verify [^`]*)`", text, re.MULTILINE)
    for words in (shlex.split(a or b, comments=True) for a, b in typed):
        command = " ".join(words[1 : 3 if words[1] in GROUPS else 2])
        assert command in COMMANDS, words
        named = {word for word in words if word.startswith("--")}
        assert named <= options(command) | EVERYWHERE | {"--out"}, words
    others = {"--strict", "--install-completion", "--out"}  # mypy's own; of the command line itself
    every = set().union(*map(options, COMMANDS)) | EVERYWHERE | others
    assert set(re.findall(r"(?<![\w-])--[a-z][a-z-]+", text)) <= every


@each_document
def test_every_link_and_file_named_exists(document: Path) -> None:
    text = document.read_text()
    for link in re.findall(r"\]\(([^)]+)\)", text):
        if link.startswith("https://"):
            continue
        name, _, heading = link.partition("#")
        target = document.parent / name if name else document
        assert target.is_file(), link
        assert not heading or heading in headings(target), link
    for name in re.findall(r"`(\.?\w[\w./-]*)`", text):
        first = ROOT / name.split("/")[0]
        made = first.name.endswith("report") or first.name == "build"
        if name in OURS or ("/" in name and first.is_dir() and not made):
            assert (ROOT / name).exists(), name


def headings(document: Path) -> set[str]:
    """A document's headings as links name them."""
    titles = re.findall(r"^#+ (.*)$", document.read_text(), flags=re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", title.lower()).replace(" ", "-") for title in titles}


@each_document
def test_every_file_shown_is_read_without_a_warning(document: Path, tmp_path: Path) -> None:
    readers = {
        "session": lambda path: session_keys.read(path, session_keys.RecordingTable),
        "rig": rig.read,
        "marker": fiducials.read_marker,
        "board": fiducials.read_board,
        "fixture": fiducials.read_fixture,
    }
    for text in blocks(document, "toml"):
        name = text.partition("\n")[0].removeprefix("# ").removesuffix(".toml")
        path = tmp_path / f"{name}.toml"
        path.write_text(text)
        if name in readers:
            assert readers[name](path)[1] == ()
        elif name == "scenario":
            library.load(str(path))
        elif name == "my_arm":
            assert robots.self_check(robots.load(str(path)), poses=20).lost == 0
        else:
            assert tomllib.loads(text)


def every_key_column_and_file_is_explained(clone: Path) -> None:
    explained = (ROOT / "docs" / "results.md").read_text()
    summary = json.loads((clone / "demo-report" / "summary.json").read_text())
    tables = [summary, summary["joints"][0], *summary["diagnosis"]]
    tables += [summary[key] for key in ("clock", "pairs", "position")]
    keys = [key for table in tables for key in table]
    header = pd.read_csv(clone / "demo-report" / "frames.csv", nrows=0)
    keys += [re.sub(r"^q\d+_", "qN_", column) for column in header]
    assert [key for key in keys if f"`{key}`" not in explained] == []
    written = {path.name + "/" * path.is_dir() for path in (clone / "demo-report").iterdir()}
    assert [name for name in written if f"`{name}`" not in README.read_text()] == []
