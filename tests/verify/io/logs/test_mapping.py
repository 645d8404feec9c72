"""Headers of other programs: what is proposed, and what is not guessed."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

import robots
from tests.support.tables import Q, T, convert, joints_of, write_table
from verify.io.logs.mapping import ColumnMapping, propose_mapping
from verify.io.logs.table import open_log

DEGREES = np.column_stack([T, np.rad2deg(Q)])


def proposed(folder: Path, names: Sequence[str], rows: int = 3, before: str = "") -> ColumnMapping:
    path = write_table(folder / "log.csv", names, np.ones((rows, len(names))), before=before)
    return propose_mapping(open_log(path), robots.load("iust_6r"))


def numbered(form: str, first: int = 1, count: int = 6) -> list[str]:
    return [form.format(number) for number in range(first, first + count)]


@pytest.mark.parametrize(
    "form",
    ["qd{}_deg", "dq{}", "tau{}", "actual_current_{}", "actual_qd_{}", "J{}_cmd", "target_J{}",
     "joint_{}_vel", "ASPos.A{}", "temp{}"],
)  # fmt: skip
def test_numbered_columns_that_are_no_readings_are_not_taken_for_joints(
    form: str, tmp_path: Path
) -> None:
    assert proposed(tmp_path, ["time_s", *numbered(form)]).joints == ()


@pytest.mark.parametrize(
    ("read", "beside"),
    [
        ("actual_J{}", "target_J{}"),
        ("AIPos.A{}", "ASPos.A{}"),
        ("/arm/joint_{}/position", "/arm/joint_{}/velocity"),
        ("joint_position_{}", "joint_effort_{}"),
    ],
)
def test_readings_are_found_beside_commands_and_velocities(
    read: str, beside: str, tmp_path: Path
) -> None:
    found = proposed(tmp_path, ["__time", *numbered(beside), *numbered(read)])
    assert [c.column for c in found.joints] == numbered(read)
    assert found.time is not None


@pytest.mark.parametrize(
    "names",
    [
        numbered("position[{}]", 0),  # of JointState: whose, its names say
        numbered("/joint_states/position[{}]", 0),
        numbered("field.position{}", 0),
        numbered("J{}", 1, 7),  # a seventh: another arm, or a track
        numbered("A{}", 1, 7),
        numbered("q{}", 0, 7),
    ],
)
def test_which_joint_is_which_is_not_guessed(names: list[str], tmp_path: Path) -> None:
    assert proposed(tmp_path, ["time_s", *names]).joints == ()


@pytest.mark.parametrize(("unit", "cells"), [("s,deg", "deg"), ("[s],[rad]", "[rad]")])
def test_a_line_of_units_below_the_names(unit: str, cells: str, tmp_path: Path) -> None:
    rows = DEGREES if cells == "deg" else np.column_stack([T, Q])
    path = write_table(tmp_path / "log.csv", ["time", *numbered("J{}")], rows)
    first, rest = path.read_text().split("\n", 1)
    path.write_text("\n".join([f"# {first}", unit + f",{cells}" * 5, rest]))
    done = convert(path, tmp_path / "out", "--robot", "iust_6r", "--yes")
    assert done.status == 0, done.err
    np.testing.assert_allclose(joints_of(tmp_path / "out"), Q, atol=1e-7)
    assert (tmp_path / "out" / "encoders.csv").read_text().startswith("t_s,q1_deg")
    path.write_text(path.read_text().replace("0.012", "zero", 1))
    said = convert(path, tmp_path / "out", "--robot", "iust_6r", "--yes", "--force").refusal
    assert "line 4: time [" in said


def test_an_unknown_unit_is_named(tmp_path: Path) -> None:
    path = write_table(tmp_path / "log.csv", ["time_s", *numbered("J{} [rev]")], DEGREES / 360)
    options = ("--robot", "iust_6r", "--yes", "--angles", "rad")
    assert 'whose unit "rev" is not known' in convert(path, tmp_path / "out", *options).refusal


def test_a_table_without_times_says_so(tmp_path: Path) -> None:
    path = write_table(tmp_path / "log.csv", ["time [min]", *numbered("J{}")], DEGREES)
    done = convert(path, tmp_path / "out", "--robot", "iust_6r", "--yes")
    assert "no column is taken for the time" in done.err


def test_times_too_coarse_for_their_readings_are_refused(tmp_path: Path) -> None:
    rows = np.column_stack([np.round(T, 1), np.rad2deg(Q)])
    path = write_table(tmp_path / "log.csv", ["time_s", *numbered("J{}")], rows)
    options = ("--robot", "iust_6r", "--yes")
    assert "time_s is written too coarsely" in convert(path, tmp_path / "out", *options).refusal
    polled = np.repeat(DEGREES, 2, axis=0)  # faster than the controller reads: the same row twice
    path = write_table(tmp_path / "polled.csv", ["time_s", *numbered("J{}")], polled)
    done = convert(path, tmp_path / "out", *options)
    assert "300 rows repeat a time" in done.err
    np.testing.assert_allclose(joints_of(tmp_path / "out"), Q, atol=1e-7)


def test_a_number_beyond_all_sense_ends_a_table_of_poses_in_one_line(tmp_path: Path) -> None:
    rows = np.column_stack([T, 900 + 0 * T, T, T])  # its square is no number: a warning of numpy's
    path = write_table(tmp_path / "p.csv", ["time_s", "x_mm", "y_mm", "z_mm"], rows)
    path.write_text(path.read_text().replace("900.000000000", "1e300", 1))
    said = convert(path, tmp_path / "out", "--yes", "--instrument", "tracker").refusal
    assert 'line 2: x_mm is "1e300"' in said


POSES = np.column_stack([T, 900 + T, 200 + T, 300 + T])
POSE_NAMES = ["time_s", "x_mm", "y_mm", "z_mm"]


def test_each_angle_of_an_orientation_has_its_own_unit(tmp_path: Path) -> None:
    angles = np.column_stack([30 + T, np.deg2rad(20 + T), 10 + T])
    names = [*POSE_NAMES, "A_deg", "B_rad", "C_deg"]
    path = write_table(tmp_path / "p.csv", names, np.column_stack([POSES, angles]))
    done = convert(path, tmp_path / "out", "--yes", "--instrument", "tracker")
    assert done.status == 0, done.err
    found = np.loadtxt(tmp_path / "out" / "poses.csv", delimiter=",", skiprows=1)[0, 4:]
    a, b, c = np.deg2rad([30, 20, 10]) / 2  # Rz(a) Ry(b) Rx(c), as a product of quaternions
    w = np.cos(a) * np.cos(b) * np.cos(c) + np.sin(a) * np.sin(b) * np.sin(c)
    z = np.sin(a) * np.cos(b) * np.cos(c) - np.cos(a) * np.sin(b) * np.sin(c)
    np.testing.assert_allclose(found[[0, 3]], [w, z], atol=1e-8)


def test_poses_of_several_targets_are_not_mixed(tmp_path: Path) -> None:
    rows = np.insert(POSES, 1, 1 + np.arange(len(T)) % 2, axis=1)
    path = write_table(tmp_path / "p.csv", ["time_s", "Target", *POSE_NAMES[1:]], rows)
    said = convert(path, tmp_path / "out", "--yes", "--instrument", "tracker").refusal
    assert 'has a column "Target"; poses of one target are expected' in said


def test_poses_with_coarse_times_are_refused(tmp_path: Path) -> None:
    rows = np.column_stack([np.round(T, 1), POSES[:, 1:]])
    path = write_table(tmp_path / "p.csv", POSE_NAMES, rows)
    said = convert(path, tmp_path / "out", "--yes", "--instrument", "tracker").refusal
    assert "time_s is written too coarsely" in said


def test_positions_as_tum_names_them(tmp_path: Path) -> None:
    path = write_table(
        tmp_path / "p.csv", ["# timestamp", "tx", "ty", "tz"], POSES / [1, 1e3, 1e3, 1e3], " "
    )
    options = ("--yes", "--instrument", "tracker", "--lengths", "m")
    assert convert(path, tmp_path / "out", *options).status == 0
    found = np.loadtxt(tmp_path / "out" / "poses.csv", delimiter=",", skiprows=1)
    np.testing.assert_allclose(found, POSES, atol=1e-5)
