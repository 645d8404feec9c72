"""`verify plan` for rigs that do not exist yet: one rig, a table of rigs, and docs/plan.md's."""

import re
import shlex
import subprocess
import sys
from pathlib import Path

import pandas as pd
import pytest

from tests.support.command import ROOT, read_summary, verify

QUICK = (
    "--observe", "offsets", "--poses", "4", "--rate-hz", "1", "--clock-uncertainty-ms", "1",
)  # fmt: skip
DOCUMENT = ROOT / "docs" / "plan.md"
TOL_ROW = 0.06  # of a figure: two digits are written


def rows(text: str) -> list[list[str]]:
    """Cells of a table's rows in Markdown, without its head."""
    lines = [line for line in text.splitlines() if line.startswith("| ")]
    return [[cell.strip() for cell in line.strip("| ").split("|")] for line in lines[2:]]


def figures(row: list[str]) -> list[float]:
    return [float(part) for cell in row[4:] for part in cell.split("/")]


def test_a_rig_to_be_built_is_planned_for(tmp_path: Path) -> None:
    out = tmp_path / "out"
    done = verify(
        "plan", "iust_6r", "--camera", "1280x720,60deg", "--baseline", "400mm", "--distance", "1.5",
        "--led", "4,120mm", "--assume", "base_rotation_deg=0", "--assume", "base_position_mm=0",
        "--tolerance", "0.05", "-o", out, *QUICK,
    )  # fmt: skip
    assert done.status == 0, done.err
    assert "rig to be built: 1280x720 pixels, 60°; baseline 0.4 m, distance 1.5 m" in done.out
    assert re.search(r"1 +± 0\.0\d+° +± 0\.\d+ mm", done.out)
    assert "Taken as exact: robot base, robot table" in done.out
    assert "tolerance 0.05°: undecided, however small the error" in done.out
    summary = read_summary(out)
    assert summary["rig"]["vergence_deg"] == pytest.approx(7.595, abs=1e-3)
    assert summary["rig"]["focal_px"] == pytest.approx(1108.5, abs=0.1)
    for joint in summary["joints"]:
        parts = sum(u**2 for u in joint["parts_deg"].values())
        assert parts == pytest.approx(joint["standard_uncertainty_deg"] ** 2)
        assert joint["largest_standard_uncertainty_deg"] >= joint["standard_uncertainty_deg"]
    assert {"plan.csv", "poses.csv", "report.pdf"} <= {entry.name for entry in out.iterdir()}


def test_several_values_make_a_table(tmp_path: Path) -> None:
    out = tmp_path / "out"
    done = verify(
        "plan", "rv_3sd", "--distance", "1.0", "--distance", "0.05", "-o", out, *QUICK
    )  # fmt: skip
    assert done.status == 0, done.err
    good, bad = rows(done.out)
    assert good[:4] == ["1280x720, 60°", "4, 120 mm", "0.4 m", "1 m"]
    assert len(good) == 5 + 6
    assert set(bad[4:]) == {"–"}
    assert "0.05 m: plan: none of" in done.err
    assert "Give a longer --distance" in done.err
    table = pd.read_csv(out / "rigs.csv")
    assert float(good[5].split("/")[0]) == pytest.approx(table["q1_deg"][0], rel=TOL_ROW)
    assert table["q1_deg"].isna().tolist() == [False, True]


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ((), "RIG: is not given; a rig.toml is needed"),
        (("--camera", "12"), '--camera: "12"; columns x rows'),
        (("--camera", "1280x720,179deg"), "5° to 150°"),
        (("--led", "2,120mm"), "--led: "),
        (("--distance", "1500"), '--distance: "1500"; a length of 0.02 to 20 m'),
        (("--baseline", "1..2"), "--baseline: "),
        (("--baseline", "0.4", "--assume", "focal=1"), "a name of focal_px, principal_point_px"),
        (("--baseline", "0.4", "--assume", "focal_px=-1"), "a value at or above 0"),
        (("--assume", "focal_px=1", "--assume", "focal_px=2"), "focal_px is given twice"),
        (("--baseline", "0.4", "--marker", "m.toml"), "--marker: is given without RIG"),
        (("rig.toml", "--table"), "--table: is given with rig.toml"),
        (("rig.toml", "--led", "4,120mm"), "--led: is given with rig.toml"),
        (("--table", "--tolerance", "0.1"), "--tolerance: is given with 16 rigs"),
        (("--distance", "0.05"), "Give a longer --distance"),
    ],
)
def test_descriptions_that_make_no_rig_are_refused(
    words: tuple[str, ...], message: str, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    done = verify("plan", "iust_6r", *words, "-o", out)
    assert message in done.refusal
    assert not out.exists()


@pytest.mark.slow
@pytest.mark.parametrize("place", [0, *(pytest.param(n, marks=pytest.mark.long) for n in (7, 15))])
def test_the_table_in_the_documents_is_what_its_command_prints(place: int) -> None:
    """Rows do not depend on each other: some of them, with the command's other options."""
    command = re.search(r"^verify (plan iust_6r --table .*)$", DOCUMENT.read_text(), re.MULTILINE)
    assert command is not None
    text = DOCUMENT.read_text()[command.end() :]
    every = rows(text.split("\n## ")[0])
    assert len(every) == 16
    row = every[place]
    camera, leds = row[0].replace("°", "deg").replace(" ", ""), row[1].replace(" ", "")
    one = ("--camera", camera, "--led", leds, "--baseline", row[2], "--distance", row[3])
    words = [*shlex.split(command[1]), *(word.replace(" ", "") for word in one)]
    # a process of its own: tests of the planner draw fewer postures
    done = subprocess.run(
        [sys.executable, "-m", "verify", *words], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    (printed,) = rows(done.stdout)
    assert printed[:4] == row[:4]
    assert figures(printed) == pytest.approx(figures(row), rel=TOL_ROW)
