"""Tables of controllers and instruments become encoders.csv and poses.csv."""

import io
import re
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import Rotation

import robots
from tests.support.command import verify
from tests.support.recorded import write_session
from tests.support.tables import ROWS, Q, T, convert, joints_of, write_table
from verify.core.records import Array
from verify.io.joints import match_joint_names
from verify.io.logs.mapping import parse_name
from verify.io.rows import END
from verify.io.session.keys import read_poses
from verify.io.session.session import open_session

TURNS = Rotation.from_rotvec(np.column_stack([0.3 * np.sin(T), 0.5 * np.cos(T), 0.1 * T]))
PLACES = np.column_stack([900 + 100 * np.sin(T), 200 * np.cos(T), 300 + T])  # mm
TRIANGLE = np.array([[0.0, 0.0, 0.0], [120.0, 0.0, 0.0], [30.0, 80.0, 0.0]])  # mm, in its own frame


def rtde(path: Path) -> Path:
    """As UR's RTDE client records: spaces between, commanded angles beside the read ones."""
    kinds = ("target_q", "actual_q", "actual_TCP_pose")
    names = ["timestamp", *(f"{kind}_{i}" for kind in kinds for i in range(6))]
    return write_table(path, names, np.column_stack([T, Q + 0.3, Q, 0 * Q]), " ")


def test_ur_rtde_takes_what_was_read_and_not_what_was_commanded(tmp_path: Path) -> None:
    done = convert(rtde(tmp_path / "rtde.csv"), tmp_path / "out", "--robot", "ur5", "--yes")
    assert done.status == 0
    assert "actual_q_0  rad  → q1_deg" in done.out
    assert "target_q" not in done.out
    np.testing.assert_allclose(joints_of(tmp_path / "out"), Q, atol=1e-8)
    times = pd.read_csv(tmp_path / "out" / "encoders.csv")["t_s"]
    np.testing.assert_allclose(times, T, atol=1e-9)


def test_a_proposal_needs_a_word_where_there_is_no_terminal(tmp_path: Path) -> None:
    source = rtde(tmp_path / "rtde.csv")
    said = convert(source, tmp_path / "out", "--robot", "ur5")
    assert '--map "t_s=timestamp:s,q1=actual_q_0:rad,' in said.refusal
    assert "actual_q_5  rad  → q6_deg" in said.out  # shown all the same
    assert not (tmp_path / "out").exists()
    mapping = said.refusal.split('"')[1]
    assert convert(source, tmp_path / "out", "--robot", "ur5", "--map", mapping).status == 0
    np.testing.assert_allclose(joints_of(tmp_path / "out"), Q, atol=1e-8)


@pytest.mark.parametrize(("answer", "status"), [("y", 0), ("", 2), ("no", 2)])
def test_a_terminal_asks(
    answer: str, status: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Typed(io.StringIO):
        def isatty(self) -> bool:
            return True

    monkeypatch.setattr("sys.stdin", Typed(f"{answer}\n"))
    monkeypatch.setattr("verify.cli.terminal.Terminal.draws", property(lambda _: True))
    done = convert(rtde(tmp_path / "rtde.csv"), tmp_path / "out", "--robot", "ur5")
    assert done.out.index("q6_deg") < done.out.index("Correct? [y/N]")
    assert done.status == status
    assert (tmp_path / "out").exists() == (status == 0)


@pytest.mark.parametrize(
    ("names", "form"),
    [
        (["Zeit [ms]", *(f"A{j}" for j in range(1, 7))],
         {"separator": ";", "comma": True, "before": "KUKA trace\nprogram;main\n\n",
          "encoding": "utf-16", "end": ";"}),
        (["time_ms", *(f"J{j}" for j in range(1, 7))], {"separator": "\t"}),
        (["Time (ms)", *(f"rax_{j} [°]" for j in range(1, 7))],
         {"separator": ";", "comma": True, "encoding": "latin-1"}),
        (["t [ms]", *(f"axis{j}_deg" for j in range(1, 7))], {}),
    ],
    ids=["kuka", "fanuc", "abb", "generic"],
)  # fmt: skip
def test_makers_tables_in_degrees_and_milliseconds(
    names: list[str], form: dict[str, str], tmp_path: Path
) -> None:
    rows = np.column_stack([T * 1e3, np.rad2deg(Q)])
    source = write_table(tmp_path / "log.csv", names, rows, **form)  # type: ignore[arg-type]
    done = convert(source, tmp_path / "out", "--robot", "iust_6r", "--yes")
    assert done.status == 0, done.err
    np.testing.assert_allclose(joints_of(tmp_path / "out"), Q, atol=1e-9)
    times = pd.read_csv(tmp_path / "out" / "encoders.csv")["t_s"]
    np.testing.assert_allclose(times, T, atol=1e-9)


def test_dates_count_from_the_first_whole_second(tmp_path: Path) -> None:
    lines = ["date;" + ";".join(f"J{j}_rad" for j in range(1, 7))]
    for k, q in enumerate(Q[:50]):
        stamp = f"2026-10-02T09:30:{7 + k // 10:02d},{k % 10}00"
        lines.append(";".join([stamp, *(f"{v:.9f}".replace(".", ",") for v in q)]))
    (tmp_path / "log.csv").write_text("\n".join(lines))
    done = convert(tmp_path / "log.csv", tmp_path / "out", "--robot", "iust_6r", "--yes")
    assert done.status == 0, done.err
    times = pd.read_csv(tmp_path / "out" / "encoders.csv")["t_s"]
    np.testing.assert_allclose(times, 0.1 * np.arange(50), atol=1e-9)


def test_a_unit_that_nothing_settles_is_asked_for(tmp_path: Path) -> None:
    names = ["time", *(f"J{j}" for j in range(1, 7))]
    source = write_table(tmp_path / "log.csv", names, np.column_stack([T, Q]))  # small: either fits
    said = convert(source, tmp_path / "out", "--robot", "iust_6r", "--yes").refusal
    assert "fit degrees and radians" in said
    stated = ("--robot", "iust_6r", "--yes", "--angles", "rad")
    assert convert(source, tmp_path / "out", *stated).status == 0
    np.testing.assert_allclose(joints_of(tmp_path / "out"), Q, atol=1e-8)


def test_readings_beyond_the_limits_name_the_unit_that_fits(tmp_path: Path) -> None:
    names = ["time_s", *(f"J{j}_rad" for j in range(1, 7))]  # says radians, holds degrees
    source = write_table(tmp_path / "log.csv", names, np.column_stack([T, np.rad2deg(Q)]))
    said = convert(source, tmp_path / "out", "--robot", "iust_6r", "--yes").refusal
    assert "in rad runs from" in said
    assert "give every column by --map, these in deg." in said
    assert not (tmp_path / "out").exists()


def replace_line(path: Path, number: int, text: str) -> None:
    lines = path.read_text().splitlines()
    lines[number - 1] = text
    path.write_text("\n".join([*lines, ""]))


@pytest.mark.parametrize(
    ("line", "text", "words"),
    [
        (41, "0.468,1,2,,4,5,6", ("line 41", "J3 is empty")),
        (41, "0.468,1,2,three,4,5,6", ("line 41", 'J3 is "three"')),
        (41, "0.468,1,2", ("line 41", "J3 is empty")),
        (41, "0,468,1,2,3,4,5,6", ("line 41", "has 8 cells", "names 7 columns")),
        (41, "0.1,1,2,3,4,5,6", ("line 41", "time goes back")),
        (1, "1,2,3,4,5,6,7", ("is no table", "header")),
        (1, "time,J1,J2,J3,J4,J5,J5", ("line 1", 'two columns "J5"')),
        (1, "time,a,b,c,d,e,f", ("has the columns time, a, b", "--map")),
    ],
)
def test_a_damaged_table_is_refused_by_its_line(
    line: int, text: str, words: tuple[str, ...], tmp_path: Path
) -> None:
    names = ["time", *(f"J{j}" for j in range(1, 7))]
    source = write_table(tmp_path / "log.csv", names, np.column_stack([T, np.rad2deg(Q)]))
    replace_line(source, line, text)
    said = convert(source, tmp_path / "out", "--robot", "iust_6r", "--yes").refusal
    assert [word for word in words if word not in said] == [], said
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("cut", [1, 2, 9, 11, 14, 60])
@pytest.mark.parametrize("decimals", [9, 0], ids=["fixed", "varying"])
def test_a_table_cut_within_its_last_row_loses_that_row_and_says_so(
    cut: int, decimals: int, tmp_path: Path
) -> None:
    source = write_table(tmp_path / "log.csv", ["time_s", *(f"J{j}_deg" for j in range(1, 7))],
                         np.column_stack([T, np.rad2deg(Q)]))  # fmt: skip
    text = source.read_text() if decimals else re.sub(r"0+(?=[,\n])", "", source.read_text())
    source.write_text(text[:-cut])
    done = convert(source, tmp_path / "out", "--robot", "iust_6r", "--yes")
    assert done.status == 0, done.err
    whole = decimals and cut == 1  # only the end of line is lacking, and equal decimals show it
    assert (END in done.err) == (not whole)
    np.testing.assert_allclose(joints_of(tmp_path / "out"), Q[: ROWS if whole else -1], atol=1e-7)


def test_a_cut_table_without_times_is_refused(tmp_path: Path) -> None:
    source = write_table(tmp_path / "log.csv", [f"J{j}_deg" for j in range(1, 7)], np.rad2deg(Q))
    source.write_text(source.read_text()[:-3])
    said = convert(source, tmp_path / "out", "--robot", "iust_6r", "--yes").refusal
    assert f"last line: {END}" in said
    assert not (tmp_path / "out").exists()


def check_poses(folder: Path, atol_mm: float = 1e-4) -> None:
    found = pd.read_csv(folder / "poses.csv")
    np.testing.assert_allclose(found[["x_mm", "y_mm", "z_mm"]], PLACES, atol=atol_mm)
    turns = Rotation.from_quat(found[["qx", "qy", "qz", "qw"]].to_numpy())
    assert (turns.inv() * TURNS).magnitude().max() < 1e-6


def zyx_degrees() -> Array:
    """Angles by a matrix product of their own: R = Rz(a) Ry(b) Rx(c)."""
    m = TURNS.as_matrix()
    a = np.arctan2(m[:, 1, 0], m[:, 0, 0])
    b = np.arctan2(-m[:, 2, 0], np.hypot(m[:, 0, 0], m[:, 1, 0]))
    return np.rad2deg(np.column_stack([a, b, np.arctan2(m[:, 2, 1], m[:, 2, 2])]))


@pytest.mark.parametrize(
    ("names", "columns", "options"),
    [
        (["A", "B", "C"], [0, 1, 2], ()),  # KUKA
        (["W", "P", "R"], [2, 1, 0], ()),  # Fanuc: fixed axes
        (["EZ", "EY", "EX"], [0, 1, 2], ()),  # ABB
        (["rx_deg", "ry_deg", "rz_deg"], [2, 1, 0], ("--rotation", "xyz")),
    ],
)
def test_euler_angles_in_the_makers_conventions(
    names: list[str], columns: list[int], options: tuple[str, ...], tmp_path: Path
) -> None:
    rows = np.column_stack([T, PLACES / 1e3, zyx_degrees()[:, columns]])
    header = ["time_s", "X [m]", "Y [m]", "Z [m]", *names]
    source = write_table(tmp_path / "poses.csv", header, rows, ";", comma=True)
    done = convert(source, tmp_path / "out", "--yes", "--instrument", "tracker", *options)
    assert done.status == 0, done.err
    check_poses(tmp_path / "out")


def test_angles_without_a_convention_are_asked_for(tmp_path: Path) -> None:
    rows = np.column_stack([T, PLACES, TURNS.as_rotvec()])
    header = ["time_s", "x_mm", "y_mm", "z_mm", "rx_rad", "ry_rad", "rz_rad"]
    source = write_table(tmp_path / "poses.csv", header, rows)
    options = ("--yes", "--instrument", "tracker")
    assert "--rotation rotvec" in convert(source, tmp_path / "out", *options).refusal
    done = convert(source, tmp_path / "out", *options, "--rotation", "rotvec")
    assert done.status == 0
    check_poses(tmp_path / "out")


def test_three_points_and_readings_make_a_session(tmp_path: Path) -> None:
    points = np.stack([TURNS.apply(np.tile(p, (ROWS, 1))) + PLACES for p in TRIANGLE], axis=1)
    header = ["time_s", *(f"P{n}{a} [mm]" for n in (1, 2, 3) for a in "xyz")]
    tracker = write_table(tmp_path / "p.csv", header, np.column_stack([T, points.reshape(ROWS, 9)]))
    log = rtde(tmp_path / "rtde.csv")
    options = ("--robot", "ur5", "--yes", "--instrument", "laser tracker")
    done = verify("convert", log, tracker, "-o", tmp_path / "out", *options)
    assert done.status == 0, done.err
    check_poses(tmp_path / "out")
    keys = tmp_path / "out" / "session.toml"
    keys.write_text(keys.read_text().replace('frame = "instrument"', 'frame = "robot_base"'))
    assert read_poses(keys)[0].poses.instrument == "laser tracker"
    points[100, 1, 0] += 2.0  # mm
    rows = np.column_stack([T, points.reshape(ROWS, 9)])
    source = write_table(tmp_path / "bent.csv", header, rows)
    said = convert(source, tmp_path / "bent", "--yes", "--instrument", "tracker").refusal
    assert "row 101" in said


def test_a_controllers_own_poses_are_not_taken_for_a_measurement(tmp_path: Path) -> None:
    header = ["time_s", *(f"J{j}_deg" for j in range(1, 7)), "X_mm", "Y_mm", "Z_mm"]
    source = write_table(tmp_path / "log.csv", header, np.column_stack([T, np.rad2deg(Q), PLACES]))
    done = convert(source, tmp_path / "out", "--robot", "iust_6r", "--yes")
    assert "come from its own encoders" in done.err
    assert [p.name for p in (tmp_path / "out").iterdir()] == ["encoders.csv"]


def test_readings_go_into_a_session_whose_robot_counts(tmp_path: Path) -> None:
    folder = write_session(tmp_path / "session")
    names = ["time_s", *(f"J{j}_deg" for j in range(1, 7))]
    source = write_table(tmp_path / "log.csv", names, np.column_stack([T, np.rad2deg(Q)]))
    assert convert(source, folder, "--yes", "--force").status == 0
    found = open_session(folder)  # all of it still fits together
    np.testing.assert_allclose(found.encoders.q, Q, atol=1e-9)
    assert found.description == "small"


def test_the_frames_that_a_session_names_in_a_urdf_stay_its_robots(tmp_path: Path) -> None:
    out = tmp_path / "out"
    out.mkdir()
    frames = '[robot_frames]\nbase = "base_link"\ntip = "wrist_3_link"\n'
    keys = f'format = 1\nrobot = "ur5"\nencoders = "encoders.csv"\n{frames}'
    (out / "session.toml").write_text(keys)
    rows = np.column_stack([T, PLACES])
    tracker = write_table(tmp_path / "p.csv", ["time", "x_mm", "y_mm", "z_mm"], rows)
    log = joints_table(tmp_path / "log.csv")
    options = ("--yes", "--force", "--instrument", "tracker")
    assert verify("convert", log, tracker, "-o", out, *options).status == 0
    assert frames in (out / "session.toml").read_text()


def test_units_stand_at_the_end_of_a_name() -> None:
    assert parse_name("time [ms]") == ("time", "ms")
    assert parse_name("J1 (°)") == ("j1", "deg")
    assert parse_name("q1_rad") == ("q1", "rad")
    assert parse_name("timestamps") == ("timestamps", "")
    assert parse_name("program") == ("program", "")


def test_joints_of_a_urdf_are_found_behind_a_prefix_in_any_order() -> None:
    arm = robots.load("ur5")
    assert isinstance(arm, robots.UrdfArm)
    names = ["finger", *sorted(f"left_{name}" for name in arm.joint_names)]
    assert match_joint_names("bag", names, arm) == tuple(f"left_{n}" for n in arm.joint_names)


def joints_table(path: Path, header: str = "timestamp", t: Array = T) -> Path:
    names = [header, *(f"actual_q_{j}" for j in range(6))]
    return write_table(path, names, np.column_stack([t, Q]))


def rows_of(path: Path) -> list[str]:
    return path.read_text().splitlines()


@pytest.mark.parametrize(
    ("number", "text", "words"),
    [
        (7, f'0.05,"{"x" * 200_000}",0,0,0,0,0', ("line 7", "actual_q_0 is")),
        (7, "0.05,0.1", ("line 7", "actual_q_1 is empty")),  # in the head too
        (7, "0.05,1e999,0,0,0,0,0", ("line 7", '"1e999"')),
        (7, "1e300,0,0,0,0,0,0", ("line 7", '"1e300"', "of at most 1e+20")),
        (7, "1e19,0,0,0,0,0,0", ("line 7", "1e+19 s after the start")),
        (2, "-1e19,0,0,0,0,0,0", ("line 3", "1e+19 s after the start")),
    ],
)
def test_hostile_cells_are_named(
    number: int, text: str, words: tuple[str, ...], tmp_path: Path
) -> None:
    source = joints_table(tmp_path / "log.csv")
    replace_line(source, number, text)
    said = convert(source, tmp_path / "out", "--robot", "ur5", "--yes").refusal
    assert [word for word in words if word not in said] == [], said
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("date", ["2026-13-01T10:00:00.25Z", "9999-01-01T10:00:00.25Z"])
def test_a_date_that_no_calendar_has_is_named_by_its_line(date: str, tmp_path: Path) -> None:
    source = joints_table(tmp_path / "log.csv", "time")
    dates = [f"2026-01-01T10:00:{t:06.3f}Z" for t in T]
    dates[4] = date
    head, *rows = rows_of(source)
    rows = [f"{d},{row.partition(',')[2]}" for d, row in zip(dates, rows, strict=True)]
    source.write_text("\n".join([head, *rows]) + "\n")
    said = convert(source, tmp_path / "out", "--robot", "ur5", "--yes").refusal
    assert f'line 6: time is "{date}"; a date is expected' in said


@pytest.mark.parametrize("end", ["\r", "\r\r\n"])
def test_line_ends_of_other_systems(end: str, tmp_path: Path) -> None:
    lines = ["a log", *rows_of(joints_table(tmp_path / "log.csv"))]
    (tmp_path / "log.csv").write_bytes(end.join(lines).encode())
    done = convert(tmp_path / "log.csv", tmp_path / "out", "--robot", "ur5", "--yes")
    assert done.status == 0, done.err
    np.testing.assert_allclose(joints_of(tmp_path / "out"), Q, atol=1e-7)


def test_a_table_of_a_million_columns_is_none(tmp_path: Path) -> None:
    (tmp_path / "log.csv").write_text(",".join(f"c{i}" for i in range(10**6)) + "\n1,2\n")
    said = convert(tmp_path / "log.csv", tmp_path / "out", "--robot", "ur5", "--yes").refusal
    assert "is no table" in said


def test_a_name_that_the_system_refuses_is_one_line(tmp_path: Path) -> None:
    said = convert(Path("a" * 300), tmp_path / "out", "--robot", "ur5", "--yes").refusal
    assert "file name too long" in said


def test_the_source_is_never_replaced(tmp_path: Path) -> None:
    source = joints_table(tmp_path / "encoders.csv")
    before = source.read_bytes()
    for out in (tmp_path, source):
        said = convert(source, out, "--robot", "ur5", "--yes", "--force").refusal
        assert f"would change {source}" in said
    assert source.read_bytes() == before


def test_tables_that_count_from_one_epoch_stay_on_one_clock(tmp_path: Path) -> None:
    log = joints_table(tmp_path / "log.csv", t=1.7e9 + 0.25 + T)
    rows = np.column_stack([1.7e9 + 3.75 + T, PLACES])
    tracker = write_table(tmp_path / "p.csv", ["time", "x_mm", "y_mm", "z_mm"], rows)
    options = ("--robot", "ur5", "--yes", "--instrument", "tracker")
    assert verify("convert", log, tracker, "-o", tmp_path / "out", *options).status == 0
    first = [
        float(rows_of(tmp_path / "out" / f"{name}.csv")[1].split(",")[0])
        for name in ("encoders", "poses")
    ]
    np.testing.assert_allclose(first, [0.25, 3.75], atol=1e-6)


def test_one_unit_for_all_does_not_overrule_a_columns_own(tmp_path: Path) -> None:
    names = ["timestamp", *(f"actual_q_{j}" for j in range(6)), "x_mm", "y_mm", "z_mm"]
    rows = np.column_stack([T, Q, PLACES, 0 * PLACES + 10])
    source = write_table(tmp_path / "log.csv", [*names, "roll", "pitch", "yaw"], rows)
    options = ("--robot", "ur5", "--yes", "--instrument", "tracker")
    said = convert(source, tmp_path / "out", *options, "--angles", "deg").refusal
    assert '"actual_q_0" is in rad, and --angles says deg' in said


def test_a_counter_is_seconds_or_milliseconds_and_asked_for(tmp_path: Path) -> None:
    source = joints_table(tmp_path / "log.csv", "time", np.arange(ROWS))
    said = convert(source, tmp_path / "out", "--robot", "ur5", "--yes").refusal
    assert '"t_s=time:ms" or :s' in said


@pytest.mark.parametrize(
    ("mapping", "words"),
    [
        ("x=a:mm,y=b:mm", "names no z"),
        ("x=a:mm,y=b:mm,z=c:mm,r1=d:deg,r2=e:deg", "names no r3"),
        ("x=a:mm,y=a:mm,z=c:mm", '"a" is x and y'),
        ("x=a:mm,y=b:mm,z=c:mm,qw=d,qx=e,qy=f,qz=g", "are 4 numbers"),
    ],
)
def test_a_mapping_of_half_a_pose_is_refused(mapping: str, words: str, tmp_path: Path) -> None:
    source = write_table(tmp_path / "p.csv", list("abcdefg"), np.ones((9, 7)))
    options = ("--instrument", "tracker", "--rotation", "ZYX", "--map", mapping)
    assert words in convert(source, tmp_path / "out", *options).refusal
