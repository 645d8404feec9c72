"""The station file that `--new-station` writes for a robot and a driver can be opened."""

from pathlib import Path

import pytest

import robots
from tests.support.recorded import MARKER, RIG
from verify.errors import InputError
from verify.live.station import file
from verify.live.station.devices import ENCODER_KEYS
from verify.live.station.keys import StationTable
from verify.live.station.station import open_station
from verify.live.station.template import SIM_ROBOT, joint_names, station_template
from verify.simulation import library
from verify.simulation.devices.station import SimulatedStation


def written(folder: Path, robot: str, driver: str | None) -> Path:
    path = folder / "station.toml"
    path.write_text(station_template(robot, driver, library.scenario_of(robot), folder).text)
    return path


@pytest.mark.parametrize("driver", ENCODER_KEYS)
def test_each_drivers_file_opens_without_a_warning(tmp_path: Path, driver: str) -> None:
    table, warnings = file.read(
        written(tmp_path, "ur10", driver if driver != "sim" else "rtde"), StationTable
    )
    assert warnings == ()
    (tmp_path / "rig.toml").write_text(RIG)
    (tmp_path / "marker.toml").write_text(MARKER)
    if driver != "sim":
        assert table.encoders.driver == driver
        opened = open_station(tmp_path / "station.toml", SimulatedStation)
        assert (opened.warnings, opened.arm.name) == ((), "ur10")
        opened.open_encoders().close()


def test_without_a_driver_it_is_the_file_as_it_stands(tmp_path: Path) -> None:
    assert written(tmp_path, SIM_ROBOT, None).read_text() == file.template()


def test_cameras_of_a_simulated_robot_are_simulated(tmp_path: Path) -> None:
    opened = open_station(written(tmp_path, "ur5", "rosbridge"), SimulatedStation)
    assert opened.arm.name == "ur5"
    assert opened.open_cameras()[0].read() is not None
    table, _ = file.read(tmp_path / "station.toml", StationTable)
    assert table.encoders.joint_names == list(robots.load("ur5").joint_names)
    opened = open_station(written(tmp_path, "iust_6r", None), SimulatedStation)
    assert len(opened.open_encoders().read()) > 0


def test_joints_are_named_by_the_urdf_or_counted() -> None:
    assert joint_names(robots.load("ur5"))[0] == "shoulder_pan_joint"
    assert joint_names(robots.load("iust_6r"))[5] == "joint_6"


def test_a_robots_own_file_is_named_from_where_the_station_is(tmp_path: Path) -> None:
    library_folder = Path(robots.__file__).parent
    arm = tmp_path / "arms" / "mine.toml"
    arm.parent.mkdir()
    arm.write_bytes((library_folder / "iust_6r.toml").read_bytes())
    folder = tmp_path / "cell"
    folder.mkdir()
    table, _ = file.read(written(folder, str(arm), "labenc"), StationTable)
    assert table.robot == "../arms/mine.toml"


@pytest.mark.parametrize(
    ("robot", "driver", "words"),
    [
        (SIM_ROBOT, "rtd", r'--driver: is "rtd"; known are .* Did you mean `rtde`\?'),
        ("ur55", "rtde", '--robot: robot "ur55" is not known, did you mean'),
        ("ur10", None, '--robot: "ur10" is not simulated'),
    ],
)
def test_what_cannot_be_written_is_refused(
    tmp_path: Path, robot: str, driver: str | None, words: str
) -> None:
    with pytest.raises(InputError, match=words):
        written(tmp_path, robot, driver)
    assert list(tmp_path.iterdir()) == []
