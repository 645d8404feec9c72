from pathlib import Path

import pytest

from tests.support.devices.bench import for_seconds, gather, kept, same_angles
from verify.devices.encoders.csv import CsvEncoders, CsvSettings
from verify.devices.encoders.text import FieldMap

HEADER = "t_s,q1_deg,q2_deg\n"


def row(i: int) -> str:
    return f"{0.1 * i:.3f},{0.5 * i:.2f},{-0.25 * i:.2f}\n"


def append(path: Path, text: str) -> None:
    with path.open("a") as file:
        file.write(text)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    path = tmp_path / "encoders.csv"
    path.write_text(HEADER + row(0) + row(1))
    return path


def driver(path: Path, fields: FieldMap | None = None) -> CsvEncoders:
    encoders = kept(CsvEncoders(CsvSettings(path, fields), same_angles(2)))
    gather(encoders, lambda _: encoders.state().connected)
    return encoders


def times(encoders: CsvEncoders, count: int) -> list[float]:
    readings = gather(encoders, lambda found: len(found) >= count)
    return [round(reading.t, 3) for reading in readings]


def test_rows_that_are_appended_are_read_and_those_before_are_not(path: Path) -> None:
    encoders = driver(path)
    append(path, row(2) + row(3))
    readings = gather(encoders, lambda found: len(found) >= 2)
    assert [round(reading.t, 3) for reading in readings] == [0.2, 0.3]
    assert readings[0].q == pytest.approx([0.0174533, -0.00872665], abs=1e-7)


@pytest.mark.realtime
def test_half_a_row_is_waited_for(path: Path) -> None:
    append(path, row(1)[:8])  # what was half there at the beginning is left out
    encoders = driver(path)
    append(path, row(1)[8:] + row(2) + row(3)[:7])
    assert times(encoders, 1) == [0.2]
    assert gather(encoders, for_seconds(0.2)) == []
    append(path, row(3)[7:])
    assert times(encoders, 1) == [0.3]
    for first, last in ((4, 40), (40, 80)):  # programs write in lumps
        append(path, "".join(row(i) for i in range(first, last)))
        assert len(times(encoders, last - first)) == last - first
    assert dict(encoders.state().bad) == {}


@pytest.mark.realtime
def test_a_file_that_is_cut_or_replaced_is_read_from_its_beginning(path: Path) -> None:
    encoders = driver(path)
    append(path, row(2))
    assert times(encoders, 1) == [0.2]
    path.write_text(HEADER + row(5))
    assert times(encoders, 1) == [0.5]
    other = path.with_suffix(".new")
    other.write_text(HEADER + row(6) + row(7) + row(8) + row(9))
    other.replace(path)
    assert times(encoders, 4) == [0.6, 0.7, 0.8, 0.9]


@pytest.mark.realtime
def test_a_file_that_comes_later_and_grows_slowly(tmp_path: Path) -> None:
    path = tmp_path / "later.csv"
    encoders = kept(CsvEncoders(CsvSettings(path), same_angles(2)))
    gather(encoders, lambda _: "does not exist yet" in encoders.state().sentence)
    path.write_text("t_s,q1_")
    gather(encoders, lambda _: "has no first line yet" in encoders.state().sentence)
    path.write_text(HEADER + row(1))
    assert times(encoders, 1) == [0.1]


@pytest.mark.realtime
def test_columns_are_found_by_name_in_any_order(tmp_path: Path) -> None:
    path = tmp_path / "mixed.csv"
    path.write_text("speed,q2_deg,t_s,q1_deg\n")
    encoders = driver(path)
    append(path, "7,-2.0,1.5,30.0\n")
    (reading,) = gather(encoders, lambda found: len(found) >= 1)
    assert reading.t == 1.5
    assert reading.q == pytest.approx([0.5235988, -0.0349066])


@pytest.mark.realtime
def test_a_header_without_joint_names_is_refused(path: Path) -> None:
    path.write_text("time,a,b\n")
    encoders = driver(path)
    append(path, "1,2,3\n")
    assert gather(encoders, for_seconds(0.2)) == []
    assert "no (or two) t_s, q1_deg, q2_deg" in encoders.state().sentence


@pytest.mark.realtime
def test_a_file_without_names_is_read_by_a_field_map(tmp_path: Path) -> None:
    path = tmp_path / "bare.csv"
    path.write_text("0;1;2\n")
    encoders = driver(path, FieldMap(2, ("t", "q1", "q2"), ";", time_unit="ms"))
    append(path, "500;1.0;2.0\nrubbish\n")
    assert times(encoders, 1) == [0.5]
    gather(encoders, lambda _: sum(encoders.state().bad.values()) == 1)
