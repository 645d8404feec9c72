import re
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from tests.support.recorded import refusal
from verify.errors import InputError
from verify.io.rows import END
from verify.io.series import ALARM_COLUMNS, read_alarms, read_encoders, read_frames


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "encoders.csv"


ENCODERS = "t_s,q1_deg,q2_deg\n0.0,10,20\n0.5,11,21\n1.0,12,22\n"
FRAMES = (
    "frame,t_left_s,t_right_s,pan_left_deg,pan_right_deg\n0,0,0.1,1,2\n1,1,1.1,3,4\n2,2,2.1,5,6\n"
)


@pytest.mark.parametrize(
    "text",
    [
        ENCODERS,
        ENCODERS.replace("\n", "\r\n"),
        ENCODERS.replace("\n", "\r"),
        "\ufeff" + ENCODERS,
        ENCODERS.replace("\n", ".0\n").replace("deg.0", "deg").rstrip("\n"),
        ENCODERS + "\n\n",
        ENCODERS.replace(",", " , "),
        ENCODERS.replace("10", "+1e1"),
        ENCODERS.replace("10", '"10"'),
        "q2_deg,t_s,q1_deg\n20,0,10\n21,0.5,11\n22,1,12\n",
        't_s,note,q1_deg,q2_deg,note\n0,"a, b",10,20,\n0.5,é,11,21,x\n1,,12,22,y\n',
    ],
    ids=[
        *("plain", "CRLF", "CR", "BOM", "no end", "blank lines"),
        *("blanks", "plus", "quotes", "order", "more"),
    ],
)
def test_one_table_reads_the_same_however_a_program_writes_it(path: Path, text: str) -> None:
    path.write_bytes(text.encode())
    encoders, warnings = read_encoders(path, 2)
    assert warnings == ()
    assert_array_equal(encoders.t, [0, 0.5, 1])
    assert_allclose(np.rad2deg(encoders.q), [[10, 20], [11, 21], [12, 22]])


@pytest.mark.parametrize("last", ["2.0,13,2", "2.0,13,23", "2.0,13", "2.", "\0\0\0"])
def test_a_last_row_that_may_lack_digits_is_left_out_with_a_warning(path: Path, last: str) -> None:
    path.write_text(ENCODERS + last)  # 23, or cut from 23.5
    encoders, warnings = read_encoders(path, 2)
    assert_array_equal(encoders.t, [0, 0.5, 1])
    assert warnings == (f"{path}: the last line {END}; it is left out.",)


@pytest.mark.parametrize(("last", "whole"), [("2.0,13,23.50", True), ("2.0,13,23.5", False)])
def test_equal_decimals_in_all_rows_show_that_the_last_is_whole(
    path: Path, last: str, whole: bool
) -> None:
    path.write_text(re.sub(r"([12]\d)$", r"\1.25", ENCODERS, flags=re.MULTILINE) + last)
    encoders, warnings = read_encoders(path, 2)
    assert (len(encoders), len(warnings)) == ((4, 0) if whole else (3, 1))


def test_a_cut_row_that_belongs_to_an_image_is_refused(path: Path) -> None:
    path.write_text(FRAMES.rstrip("\n"))
    assert "last line: has no end of line" in str(refusal(read_frames, path))


def test_frames_have_the_rigs_pan_where_the_file_gives_none(path: Path) -> None:
    path.write_text("frame,t_left_s,t_right_s\n0,0,0\n1,1,1\n")
    frames, _ = read_frames(path, pan=(0.25, 0.5))
    assert_array_equal(frames.pan_left, [0.25, 0.25])
    assert_array_equal(frames.pan_right, [0.5, 0.5])


@settings(max_examples=50)
@given(
    steps=st.lists(st.floats(1e-6, 1e6), min_size=1, max_size=20),
    angle=st.floats(-1e6, 1e6, allow_subnormal=False),
)
def test_numbers_that_pandas_writes_are_read_exactly(
    steps: list[float], angle: float, tmp_path_factory: pytest.TempPathFactory
) -> None:
    path = tmp_path_factory.getbasetemp() / "encoders.csv"
    times = np.unique(np.cumsum(steps))
    pd.DataFrame({"t_s": times, "q1_deg": angle}).to_csv(path, index=False)
    encoders, _ = read_encoders(path, 1)
    assert_array_equal(encoders.t, times)
    assert_array_equal(encoders.q[:, 0], np.deg2rad(np.full(len(times), angle)))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", ": is empty"),
        ("\n", "line 1: is empty; it names the columns"),
        ("t_s,q1_deg,q2_deg\n", "no rows below its header"),
        ("0,1,2\n1,2,3\n", "line 1: holds numbers; it names the columns"),
        (ENCODERS.replace(",", ";"), "line 1: separates by semicolons; commas"),
        (ENCODERS.replace(".", ",").replace(",", ";"), "line 1: separates by semicolons"),
        (ENCODERS.replace(",", "\t"), "line 1: separates by tabs"),
        (ENCODERS.replace("0.5,", "0,5,"), "line 3: has 4 cells; the first line names 3 columns"),
        (ENCODERS.replace("0.5,11,21", "0.5,11"), "line 3: has 2 cells"),
        (ENCODERS.replace("11,", ","), "line 3: q1_deg is empty; every row needs a number"),
        (ENCODERS.replace("11,", "nan,"), 'line 3: q1_deg is "nan"'),
        (ENCODERS.replace("11,", "1e300,"), "line 3: q1_deg is 1e+300; at most 1e+20 is plausible"),
        (ENCODERS.replace("11,", "1_1,"), 'line 3: q1_deg is "1_1"'),
        (ENCODERS.replace("11,", "ERR\x1b[31m,"), 'line 3: q1_deg is "ERR\\x1b[31m"'),
        ("t_s,q1_deg,q2_deg\n\n\n0,1,\n", "line 4: q2_deg is empty"),
        (ENCODERS.replace("0.5,", "0.0,"), "line 3: t_s is 0 after 0; times rise strictly"),
        (ENCODERS.replace("1.0,", "0.25,"), "line 4: t_s is 0.25 after 0.5"),
        (ENCODERS.replace("t_s", "time"), "line 1: has no column t_s; expected are t_s, q1_deg"),
        (ENCODERS.replace("q1_deg", "q2_deg"), "line 1: has no column q1_deg"),
        ("t_s,q1_deg\n0,1\n", "line 1: has 1 joint columns, q1_deg to q1_deg; the robot has 2"),
        ("t_s,q1_deg,q2_deg,q3_deg\n0,1,2,3\n", "line 1: has 3 joint columns, q1_deg to q3_deg"),
        ("t_s,q1,q2\n0,1,2\n", "line 1: has no column q1_deg"),
        (
            "t_s,t_s,q1_deg,q2_deg\n0,0,1,2\n",
            "has two columns t_s; each has a name of its own. Delete",
        ),
        (
            "t_s,q1_rad,q2_rad\n0,1,2\n",
            "q2_deg. Convert q1_rad to deg, and name it q1_deg",
        ),
        (ENCODERS.replace("t_s", "T_S"), "the column in the first line. Did you mean `T_S`?"),
        (ENCODERS.replace("0.5", '"0.5'), "line 3: has a quote that is not closed"),
        (ENCODERS.replace("0.5", '"0.5') + 20_000 * "9,9,9\n", "line 3: has a quote that is not"),
        (ENCODERS.replace("11", "1" * 200_000 + "x"), "line 3: is not CSV"),
    ],
)
def test_a_wrong_table_of_readings_is_refused_by_its_line(
    path: Path, text: str, message: str
) -> None:
    path.write_text(text)
    found = str(refusal(read_encoders, path, 2))
    assert message in found
    assert found.startswith(str(path))


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("\n1,1,", "\n2,1,", "line 3: frame is 2; 1 is expected"),
        ("\n0,0,", "\n1,0,", "line 2: frame is 1; 0 is expected"),
        ("\n2,2,", "\n1,2,", "line 4: frame is 1; 2 is expected"),
        ("\n1,1,", "\n1,0,", "line 3: t_left_s is 0 after 0"),
        ("1.1", "0.05", "line 3: t_right_s is 0.05 after 0.1"),
        ("1.1,3", "1.1,", "line 3: pan_left_deg is empty"),
        ("pan_left_deg", "note", "line 1: has no column pan_left_deg; expected are frame, "),
        (",pan_right_deg", ",note", "line 1: has no column pan_right_deg"),
        ("t_left_s", "t_lef_s", "Did you mean `t_lef_s`?"),
    ],
)
def test_a_wrong_table_of_frames_is_refused_by_its_line(
    path: Path, old: str, new: str, message: str
) -> None:
    path.write_text(FRAMES.replace(old, new))
    found = str(refusal(read_frames, path))
    assert message in found
    assert "Delete" not in found
    assert "delete repeats" not in found


def test_a_table_in_utf_16_is_refused(path: Path) -> None:
    path.write_bytes(ENCODERS.encode("utf-16"))
    with pytest.raises(InputError, match="is UTF-16; UTF-8 is expected"):
        read_encoders(path, 2)


def test_any_last_line_without_an_end_is_left_out_of_a_torn_table(path: Path) -> None:
    path.write_text(ENCODERS.replace("2\n", "2.5\n").replace("20\n", "20.5\n") + "1.5,13,23.5")
    encoders, warnings = read_encoders(path, 2, torn=True)
    assert len(encoders) == 3
    assert len(warnings) == 1


def test_the_one_wrong_cell_of_many_rows_is_found(path: Path) -> None:
    header = "t_s," + ",".join(f"q{joint}_deg" for joint in range(1, 7))
    rows = [f"{i * 0.002:.3f},{i % 360 - 180}.1234,2.0,3.0,4.0,5.0,6.0" for i in range(50_000)]
    path.write_text("\n".join([header, *rows[:-1], "5000,1,2,3,,5,6", ""]))
    with pytest.raises(InputError, match="line 50001: q4_deg is empty"):
        read_encoders(path, 6)


def test_a_reading_that_no_arm_reaches_is_named_and_left_out(path: Path) -> None:
    rows = [f"{0.01 * i:.2f},{0.5 * i:.3f},{-0.2 * i:.3f}" for i in range(40)]
    rows[17] = "0.17,1e12,-3.4"
    rows[30] = "0.30,0,0"  # a dropped telegram
    path.write_text("\n".join(["t_s,q1_deg,q2_deg", *rows, ""]))
    encoders, warnings = read_encoders(path, 2)
    assert len(encoders) == 38
    (warning,) = warnings
    assert warning == (
        "encoders.csv: 2 of 40 readings were left out, the arm cannot reach them: line 19 "
        "(q1_deg), line 32 (q1_deg), line 32 (q2_deg)."
    )


@pytest.mark.parametrize("leap_deg", [3.0, -6.0, 40.0])
@pytest.mark.parametrize("rows", [1, 2])
def test_a_leap_beyond_an_arms_acceleration_is_left_out(
    leap_deg: float, rows: int, path: Path
) -> None:
    t = 0.01 * np.arange(200)
    table = pd.DataFrame({"t_s": t, "q1_deg": 40 * np.sin(3 * t), "q2_deg": 5 * t})
    table.loc[90 : 89 + rows, "q1_deg"] += leap_deg
    table.to_csv(path, index=False)
    encoders, (warning,) = read_encoders(path, 2)
    assert len(encoders) == 200 - rows
    assert "line 92 (q1_deg)" in warning


def test_a_belt_that_slips_and_an_angle_that_wraps_are_no_spikes(path: Path) -> None:
    rows = [f"{0.01 * i:.2f},{(170 + i + 180) % 360 - 180},{20 * (i > 15)}" for i in range(40)]
    path.write_text("\n".join(["t_s,q1_deg,q2_deg", *rows, ""]))
    assert read_encoders(path, 2)[1] == ()


def test_visits_have_no_spikes_and_a_reading_far_outside_the_limits_is_one(path: Path) -> None:
    """Random postures 0.1 s apart jump away and come back as a matter of course."""
    q = np.random.default_rng(1).uniform(-60, 60, (500, 2))
    q[7, 1] = 655.35
    table = pd.DataFrame({"t_s": 0.1 * np.arange(500), "q1_deg": q[:, 0], "q2_deg": q[:, 1]})
    table.to_csv(path, index=False)
    limits = np.deg2rad([-60.0, -60.0]), np.deg2rad([60.0, 60.0])
    encoders, warnings = read_encoders(path, 2, limits=limits)
    assert len(encoders) == 499
    assert "line 9 (q2_deg)" in warnings[0]


def test_readings_without_times_belong_to_the_pairs_row_by_row(path: Path) -> None:
    frames_file = path.with_name("frames.csv")
    frames_file.write_text("frame\n0\n1\n2\n")
    pairs, _ = read_frames(frames_file)
    path.write_text(re.sub(r"(?m)^[^,]*,", "", ENCODERS))
    encoders, _ = read_encoders(path, 2, pairs=pairs)
    assert not pairs.timed
    assert_array_equal(encoders.t, pairs.t_left)
    path.write_text("q1_deg,q2_deg\n1,2\n")
    with pytest.raises(InputError, match="has 1 rows; the 3 poses or pairs have no times"):
        read_encoders(path, 2, pairs=pairs)
    path.write_text(ENCODERS)
    with pytest.raises(InputError, match="has times; the 3 poses or pairs have no times"):
        read_encoders(path, 2, pairs=pairs)


def test_readings_at_the_times_of_the_poses_are_visits(path: Path) -> None:
    """A grid's rows: the first joint leaps away and back, as no motion would."""
    frames_file = path.with_name("frames.csv")
    t = 0.1 * np.arange(40)
    q = np.where(np.arange(40) % 20 == 7, 170.0, 0.0)
    pd.DataFrame({"frame": range(40), "t_left_s": t, "t_right_s": t}).to_csv(
        frames_file, index=False
    )
    pd.DataFrame({"t_s": t, "q1_deg": q}).to_csv(path, index=False)
    assert len(read_encoders(path, 1)[0]) == 38
    assert len(read_encoders(path, 1, pairs=read_frames(frames_file)[0])[0]) == 40


@pytest.mark.parametrize(
    ("old", "new", "place"),
    [("2,", "2.5.1,", "line 3"), (",4,", ",7,", "line 2"), ("alarm,", "alarms,", "line 1")],
)
def test_alarms_come_back_as_told_and_a_malformed_file_is_one_line(
    path: Path, old: str, new: str, place: str
) -> None:
    rows = "1,change,a,,5.5,,4,2+3,0.5,0.01,Joint 4 jumped\n2,device,b,c,,left camera,,,,,silent\n"
    text = ",".join(ALARM_COLUMNS) + "\n" + rows
    assert read_alarms(path, 6) is None
    path.write_text(text)
    alarms = read_alarms(path, 6)
    assert alarms.to_csv(index=False) == text
    path.write_text(text.replace(old, new, 1))
    with pytest.raises(InputError, match=place):
        read_alarms(path, 6)
