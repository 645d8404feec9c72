"""`verify plan` from a rig to the motion of the next session, and what it refuses."""

import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import robots
from tests.support import planning
from tests.support.command import read_summary, verify
from verify.io import fiducials
from verify.io import rig as io_rig

NEAR = ("--near", ",".join(f"{angle:g}" for angle in planning.HOME_DEG), "--within-deg", "35")
QUICK = (*NEAR, "--poses", "4", "--rate-hz", "4", "--clock-uncertainty-ms", "0.5")


@pytest.fixture(scope="module", autouse=True)
def _few() -> Iterator[None]:
    with planning.few_postures():
        yield


@pytest.fixture(scope="module")
def rig(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("rig")
    bench = planning.bench()
    io_rig.write(folder / "rig.toml", bench.rig)
    fiducials.write_marker(folder / "marker.toml", bench.marker)
    return folder


def test_a_plan_is_a_motion_and_its_prediction(rig: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    done = verify("plan", "iust_6r", rig / "rig.toml", "-o", out, *QUICK)
    assert done.status == 0, done.err
    assert "4 poses" in done.out
    assert re.search(r"\n  6 +± 0\.\d+° +± 0 mm ", done.out)  # axis 6 passes through the flange
    assert "No uncertainty is stated for" in done.err
    assert {entry.name for entry in out.iterdir()} == {
        "plan.csv", "poses.csv", "report.html", "report.pdf", "results", "summary.json",
    }  # fmt: skip
    summary = read_summary(out)
    assert summary["kind"] == "plan"
    assert summary["observe"] == ["offsets", "gains", "backlash", "clock"]
    assert set(summary["inputs"]) == {"rig.toml", "marker.toml"}
    assert all(joint["minimum_detectable_error_deg"] > 0 for joint in summary["joints"])
    rows = pd.read_csv(out / "plan.csv")
    q = np.deg2rad(rows[[f"q{j}_deg" for j in range(1, 7)]].to_numpy())
    assert robots.within_limits(robots.load("iust_6r"), q).all()
    assert np.abs(np.diff(q, axis=0) / np.diff(rows[["t_s"]], axis=0)).max() < np.deg2rad(30.1)
    assert pd.read_csv(out / "poses.csv")["pose"].dropna().tolist() == [1, 2, 3, 4, 3, 2, 1]
    assert verify("report", out).status == 0
    assert "Planned session of iust_6r" in (out / "report.html").read_text()


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("--near", "1,2,3"), '--near: "1,2,3" is not a posture of iust_6r; 6 numbers'),
        (("--near", "0,0,0,0,0,200"), "--near: joint 6 stands at 200°; its limits are -170°"),
        (("--poses", "5", "--duration-s", "60"), "--duration-s: is given with --poses"),
        (("--duration-s", "1", *NEAR), "--duration-s: 1 s; 4 poses take"),
        (("--duration-s", "-3"), "--duration-s: -3; a number above 0"),
        (("--speed-deg-s", "nan"), "--speed-deg-s: is nan; a finite number"),
        (("--speed-deg-s", "0.001", *NEAR), "at most 36,000 can be predicted. Give a higher"),
        (("--speed-deg-s", "1e-300"), "'--speed-deg-s': 1e-300 is not in the range x>=0.001"),
        (("--hold-s", "1e300"), "'--hold-s': 1e+300 is not in the range 0.0<=x<=3600.0"),
        (("--rate-hz", "0"), "--rate-hz: 0; a number above 0"),
        (("--rate-hz", "1e6"), "'--rate-hz': 1000000.0 is not in the range x<=200.0"),
        (("--skew-ms", "200"), "--skew-ms: 200 ms; less than the time between two pairs"),
        (("--marker", "nowhere.toml"), "nowhere.toml"),
        (("--observe", "everything"), "everything"),
        (("--view-angle-deg", "1"), "by LEDs turned away from a camera"),
        (("--floor-mm", "3000", *NEAR), "by the arm below the floor"),
    ],
)
def test_impossible_requests_are_refused_in_one_line(
    words: tuple[str, ...], message: str, rig: Path, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    done = verify("plan", "iust_6r", rig, "-o", out, *words)
    assert message in done.refusal
    assert not out.exists()


def test_files_that_are_missing_or_too_short_are_named(rig: Path, tmp_path: Path) -> None:
    alone = tmp_path / "alone.toml"
    alone.write_bytes((rig / "rig.toml").read_bytes())
    done = verify("plan", "iust_6r", alone)
    assert "error: --marker: is not given, and there is no" in done.refusal
    assert 'did you mean "iust_6r"?' in verify("plan", "iust_7r", rig).refusal
    text = (rig / "marker.toml").read_text().split("[[led]]")
    (tmp_path / "two.toml").write_text("[[led]]".join(text[:3]))
    done = verify("plan", "iust_6r", rig, "--marker", tmp_path / "two.toml")
    assert "names 2 LEDs; a plan needs 3 or more" in done.refusal
    taken = verify("plan", "iust_6r", rig, "-o", tmp_path)  # refused before any work
    assert "exists and is not empty" in taken.refusal
