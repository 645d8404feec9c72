"""grab.toml: units, defaults, refusals in one line."""

from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

import robots
from tests.support.grasp.cells import cell, example
from verify.errors import InputError
from verify.grasping import cell as grasping_cell


def test_the_example_of_the_page_is_read_in_metres_and_radians(tmp_path: Path) -> None:
    read = cell(tmp_path)
    assert read.table.clearance == 0.03
    assert_allclose(read.upper, [0.56, 0.3, 0.6])
    assert_allclose(read.gripper.flange_T_grip[:3, 3], [0, 0, 0.15])
    assert_allclose(read.gripper.flange_T_grip[:3, :3], np.eye(3))
    assert_allclose(read.approach.direction, [0, 0, -1])
    assert_allclose(np.degrees(read.moving.home), [0, 0, 90, 0, 90, 0])
    assert read.accuracy.robot == 5e-4
    assert read.still.speed == 0.01


def test_documented_defaults_are_the_defaults(tmp_path: Path) -> None:
    whole = cell(tmp_path)
    kept = []
    for part in example().split("\n["):
        name = part.partition("]")[0]
        if name not in ("approach", "motion", "still", "watchdog"):
            lines = [line for line in part.splitlines() if "clearance" not in line]
            kept.append("\n".join(line for line in lines if "coverage" not in line))
    path = tmp_path / "short.toml"
    path.write_text("\n[".join(kept), encoding="utf-8")
    short, _ = grasping_cell.read(path)
    for part in ("table", "accuracy", "still", "watch"):
        assert getattr(short, part) == getattr(whole, part)
    assert short.approach.height == whole.approach.height
    assert short.approach.jerk == whole.approach.jerk
    assert short.moving.share == whole.moving.share
    assert short.moving.link_radius == whole.moving.link_radius
    assert short.moving.home is None


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("opening_mm = 110.0", "opening_mm = 0.0", ["gripper.opening_mm", "is 0", "above 0"]),
        ("tips_mm = 15.0", "tips_mm = 95.0", ["gripper.tips_mm", "between the palm"]),
        ("upper_mm = [560.0", "upper_mm = [200.0", ["workspace.lower_mm", "above upper_mm in x"]),
        ("height_mm = 0.0 ", "height_mm = 900.0 ", ["workspace.upper_mm", "above the table"]),
        ("[0.0, 0.0, -1.0]", "[0.0, 0.0, 0.0]", ["approach.direction", "no length"]),
        ("share = 0.1", "share = 1.5", ["motion.share", "at most 1"]),
        ("90.0, 0.0, 90.0, 0.0]", "90.0]", ["motion.home_deg", "has 3 angles", "6 joints"]),
        ("coverage = 0.95", "coverage = 1.0", ["accuracy.coverage", "below 1"]),
        ("stale_s = 0.3", "stale_s = 0.0", ["watchdog.stale_s", "above 0"]),
    ],
)
def test_a_wrong_value_is_named_with_its_key(
    tmp_path: Path, old: str, new: str, words: list[str]
) -> None:
    text = example()
    assert old in text
    path = tmp_path / "grab.toml"
    path.write_text(text.replace(old, new, 1), encoding="utf-8")
    with pytest.raises(InputError) as caught:
        grasping_cell.read(path)
    message = str(caught.value)
    assert "\n" not in message
    for word in ["grab.toml", *words]:
        assert word in message


def test_an_unknown_key_is_a_warning(tmp_path: Path) -> None:
    path = tmp_path / "grab.toml"
    path.write_text(example().replace("tips_mm", "tip_mm = 1.0\ntips_mm"), encoding="utf-8")
    _, warnings = grasping_cell.read(path)
    assert len(warnings) == 1
    assert "gripper.tip_mm" in warnings[0]


def test_the_melfa_s_speeds_are_the_published_ones() -> None:
    arm = robots.load("rv_3sd_melfa")
    assert_allclose(np.degrees(arm.speed), [250, 187, 250, 412, 412, 660])
    # the public URDF's figures, in rad/s
    assert_allclose(arm.speed, [4.36332, 3.26377, 4.36332, 7.19076, 7.19076, 11.5192], rtol=1e-5)


def test_a_station_without_a_cell_is_told_how_to_name_one(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"grab\.toml: does not exist; .* --cell PATH\.$"):
        grasping_cell.read(tmp_path / "grab.toml")
