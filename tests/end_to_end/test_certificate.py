"""A result checked by another program: the recipe of docs/checking.md, and what it must catch."""

import json
import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

import reports
from reports.results import to_json_value
from tests.support.command import SAMPLES, sample_results
from tests.support.recorded import replace
from verify import analyse, open_session

DOCS = Path(__file__).parents[2] / "docs" / "checking.md"
FAULTY = SAMPLES / "multi_joint_fault_6r"


@pytest.fixture(scope="module")
def recipe(tmp_path_factory: pytest.TempPathFactory) -> Path:
    found = re.search(r"```python\n(.*?)```", DOCS.read_text(encoding="utf-8"), re.DOTALL)
    script = tmp_path_factory.mktemp("recipe") / "check.py"
    script.write_text(found[1], encoding="utf-8")
    return script


@pytest.fixture(scope="module")
def result(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return written(sample_results("multi_joint_fault_6r"), tmp_path_factory.mktemp("result"))


def written(results: reports.Results, out: Path) -> Path:
    """What a checker reads of OUT; the reports themselves are no part of it."""
    reports.write(results, out / "results")
    (out / "summary.json").write_text(json.dumps(to_json_value(results.summary), allow_nan=False))
    return out


@pytest.fixture(scope="module")
def hiding(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """The same session with its base found through the encoders, and its result."""
    folder = tmp_path_factory.mktemp("hiding")
    session = shutil.copytree(FAULTY, folder / "session")
    replace(session / "rig.toml", 'source = "fixture"', 'source = "motion"')
    return session, written(analyse(open_session(session)), folder / "out")


def checked(recipe: Path, session: Path, out: Path) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, str(recipe), str(session), str(out)]
    return subprocess.run(command, capture_output=True, text=True, check=False)


def changed(out: Path, to: Path, change: dict[str, Any], part: str = "joint 2") -> Path:
    """A copy whose summary says something else of a part: joint 2, position, the decision."""
    shutil.copytree(out, to)
    path = to / "summary.json"
    summary = json.loads(path.read_text())
    entry = summary["joints"][int(part[-1]) - 1] if part.startswith("joint") else summary[part]
    entry.update(change)
    path.write_text(json.dumps(summary))
    return to


def test_a_result_passes_the_recipe_of_the_documentation(recipe: Path, result: Path) -> None:
    answer = checked(recipe, FAULTY, result)
    assert answer.returncode == 0, answer.stderr
    assert "inputs, verdicts and budget are as stated" in answer.stdout
    summary = json.loads((result / "summary.json").read_text())
    assert set(summary["software"]) == {"python", "numpy", "scipy", "opencv"}
    assert re.fullmatch(r"sha256:[0-9a-f]{64}", summary["session"]["robot_fingerprint"])
    assert summary["decision"]["tolerance_from"] == "session.toml"
    assert all(re.fullmatch(r"sha256:[0-9a-f]{64}", d) for d in summary["inputs"].values())


def test_a_session_that_was_changed_since_does_not(
    recipe: Path, result: Path, tmp_path: Path
) -> None:
    session = shutil.copytree(FAULTY, tmp_path / "session")
    with (session / "encoders.csv").open("a") as file:
        file.write("\n")
    answer = checked(recipe, session, result)
    assert answer.returncode != 0
    assert "encoders.csv is not what was read" in answer.stderr


@pytest.mark.slow
@pytest.mark.parametrize(
    ("part", "change", "message"),
    [
        ("joint 2", {"verdict": "conform"}, "joint 2: nonconform"),
        ("position", {"worst_error_standard_uncertainty_mm": 1.0}, "uncertainty 1.0"),
        ("orientation", {"tolerance_deg": 0.36}, "orientation: undecided"),
        ("decision", {"lack_of_fit": True}, "joint 1: undecided"),
    ],
)
def test_a_summary_that_was_changed_does_not(
    recipe: Path, result: Path, tmp_path: Path, part: str, change: dict[str, Any], message: str
) -> None:
    answer = checked(recipe, FAULTY, changed(result, tmp_path / "out", change, part))
    assert answer.returncode != 0
    assert message in answer.stderr


@pytest.mark.slow
def test_a_result_with_hidden_joints_passes_too(
    recipe: Path, hiding: tuple[Path, Path], tmp_path: Path
) -> None:
    """What varies of a hidden joint's error decides, and the flange is left undecided."""
    session, out = hiding
    answer = checked(recipe, session, out)
    assert answer.returncode == 0, answer.stderr
    summary = json.loads((out / "summary.json").read_text())
    hidden = summary["joints"][0]
    assert hidden["mean_error_deg"] is None
    assert [hidden["verdict"], summary["position"]["verdict"]] == ["undecided", "undecided"]
    swinging = changed(out, tmp_path / "out", {"half_range_deg": [9.0] * 6}, "decision")
    assert "joint 1: nonconform" in checked(recipe, session, swinging).stderr
