"""A station file is checked like a session's, and explains itself."""

import re
from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pytest
from numpy.testing import assert_allclose

from tests.support.recorded import MARKER, RIG
from verify.devices.encoders.csv import CsvEncoders
from verify.devices.encoders.labenc.reader import LabencEncoders
from verify.devices.encoders.opcua import OpcUaEncoders
from verify.devices.encoders.rosbridge import RosbridgeEncoders
from verify.devices.encoders.rtde import RtdeEncoders
from verify.devices.encoders.text import TextEncoders
from verify.devices.melfa.reader import MelfaEncoders
from verify.devices.melfa.realtime import RealtimeEncoders
from verify.devices.pan import PanReader, PanServo
from verify.devices.protocols import CameraSettings
from verify.errors import InputError
from verify.io import rig as io_rig
from verify.io.session.session import open_session
from verify.live.recording.session import SessionFacts
from verify.live.station import devices, file
from verify.live.station.keys import SimSettings, StationTable
from verify.live.station.station import (
    PanDrive,
    Station,
    open_recording_station,
    open_station,
)
from verify.simulation.devices.station import SimulatedStation

REAL = """format = 1
robot = "iust_6r"
description = "the lab's arm"
rig = "rig.toml"
marker = "marker.toml"

[left]
source = 0
rate_hz = 30.0
exposure_ms = 5.0

[right]
source = "/dev/video2"

[encoders]
driver = "labenc"
port = "tcp:127.0.0.1:10001"
"""
NAMED = 'joint_names = ["a", "b", "c", "d", "e", "f"]\n'
NODES = 'nodes = ["ns=2;s=Axes"]\nangle_unit = "rad"\nstamp = "arrival"\nlatency_ms = 50.0\n'


def station(folder: Path, text: str = REAL, **replaced: str) -> Station:
    (folder / "rig.toml").write_text(RIG)
    (folder / "marker.toml").write_text(MARKER)
    path = folder / "station.toml"
    for old, new in replaced.items():
        assert text.count(old) == 1
        text = text.replace(old, new)
    path.write_text(text)
    return open_station(path, SimulatedStation)


def encoders(folder: Path, text: str) -> Station:
    return station(folder, REAL[: REAL.index("[encoders]")] + "[encoders]\n" + text)


def test_the_template_runs_as_it_is(tmp_path: Path) -> None:
    made = station(tmp_path, file.template())
    assert made.warnings == ()
    assert made.robot == "rv_3sd_melfa"
    left, right = made.open_cameras()
    assert left.read() is not None
    assert right.read() is not None
    reading = made.open_encoders().read()
    assert len(reading) > 0
    assert made.open_pan() is None


def test_the_template_names_every_key_and_no_other(tmp_path: Path) -> None:
    text = file.template()

    def keys(kind: type[msgspec.Struct]) -> set[str]:
        return set(kind.__struct_encode_fields__)

    tables = {f.name: f.type for f in msgspec.structs.fields(StationTable)}
    named = set(re.findall(r"\b([a-z][a-z0-9_]*)\b", text))
    for name, kind in tables.items():
        assert name in named
        for part in [kind, *getattr(kind, "__args__", ())]:
            if isinstance(part, type) and issubclass(part, msgspec.Struct):
                assert keys(part) <= named, f"[{name}]"
    # with every explained key switched on, none is unknown
    message = re.sub(r"(?m)^# (?=\[|[a-z_]+ = )", "", text)
    message = re.sub(r"(?m)^(driver|port|baud|columns|pattern|checksum) = .*\n", "", message)
    message = re.sub(
        r"(?m)^(rate_hz|sign|unit|latch_span_us|stamp|cycle_ms|latency_ms|angle_unit) = .*\n",
        "",
        message,
    )
    message = message.replace("[encoders]", '[encoders]\ndriver = "sim"')
    (tmp_path / "station.toml").write_text(message)
    _, warnings = file.read(tmp_path / "station.toml", StationTable)
    assert not [w for w in warnings if "does not know" in w]


def test_facts_come_out_in_si_units(tmp_path: Path) -> None:
    more = "resolution_deg = 0.01\n[tolerance]\njoints_deg = 0.5\nposition_mm = 2.0\n"
    more += '[clock]\nencoder_offset_s = 0.25\n[recording]\nfolder = "records"\n'
    made = station(tmp_path, REAL + more + 'name = "{robot} %Y"\n')
    assert_allclose(made.tolerance.joints, np.deg2rad([0.5] * 6))
    assert made.tolerance.position == 0.002
    assert made.watched.clock.encoder_offset == 0.25
    assert made.watched.resolution == pytest.approx(np.deg2rad(0.01))
    assert made.recording.folder == tmp_path / "records"
    assert made.recording.name == "iust_6r %Y"
    assert made.name == "the lab's arm"
    assert not made.follow


@pytest.mark.parametrize(
    ("text", "kind"),
    [
        ('driver = "melfa"\nport = "tcp:127.0.0.1:1"\nterminator = "CR LF"\n', MelfaEncoders),
        ('driver = "melfa-realtime"\nport = "udp:127.0.0.1:1"\ncycle_ms = 3.5\n', RealtimeEncoders),
        ('driver = "labenc"\nport = "/dev/ttyUSB9"\nunit = "counts"\n', LabencEncoders),
        (
            'driver = "text"\nport = "p"\ncolumns = ["q1", "q2", "q3", "q4", "q5", "q6"]\n',
            TextEncoders,
        ),
        ('driver = "csv"\npath = "readings.csv"\n', CsvEncoders),
        ('driver = "rtde"\nport = "tcp:127.0.0.1:1"\nrate_hz = 125.0\n', RtdeEncoders),
        (f'driver = "rosbridge"\nport = "ws://127.0.0.1:1"\n{NAMED}', RosbridgeEncoders),
        (f'driver = "opcua"\nport = "opc.tcp://127.0.0.1:1"\n{NODES}', OpcUaEncoders),
    ],
)
def test_every_driver_can_be_named(tmp_path: Path, text: str, kind: type) -> None:
    made = encoders(tmp_path, text)
    opened = made.open_encoders()
    assert isinstance(opened, kind)
    assert made.warnings == ()
    opened.close()


ROSBRIDGE = 'driver = "rosbridge"\nport = "ws://127.0.0.1:9090"\n'
OPCUA = 'driver = "opcua"\nport = "opc.tcp://127.0.0.1:4840"\n'


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (
            'driver = "rtde"\n',
            "encoders.port: is missing; an address such as tcp:192.168.0.20:30004",
        ),
        (
            'driver = "rtde"\nport = "/dev/ttyUSB0"\n',
            'encoders.port: is "/dev/ttyUSB0"; an address',
        ),
        (
            'driver = "rtde"\nport = "tcp:h:1"\nrate_hz = 0.0\n',
            "rate_hz: is 0; a number from 1 to 500",
        ),
        (f'driver = "rosbridge"\nport = "tcp:h:9090"\n{NAMED}', "such as ws://192.168.0.20:9090"),
        (ROSBRIDGE, "encoders.joint_names: is missing; one for each of the 6 joints"),
        (
            ROSBRIDGE + 'joint_names = ["a", "b"]\n',
            "joint_names: names 2; the names of the 6 joints",
        ),
        (ROSBRIDGE + NAMED.replace("b", "a"), 'joint_names: names "a" twice'),
        (ROSBRIDGE + NAMED + 'topic = "/joint states"\n', 'topic: is "/joint states"; the name of'),
        (
            ROSBRIDGE + NAMED + 'stamp = "now"\n',
            'stamp: is "now"; expected is "source" or "arrival"',
        ),
        (ROSBRIDGE + NAMED + "cycle_ms = -1.0\n", "cycle_ms: is -1; a number from 0 to 1000"),
        (ROSBRIDGE + NAMED + "latency_ms = nan\n", "latency_ms: is nan; a finite number"),
        (OPCUA, "encoders.nodes: is missing"),
        (
            OPCUA + 'nodes = ["i=1", "i=2"]\n',
            "nodes: names 2; a node for each of the 6 joints, or one",
        ),
        (OPCUA + 'nodes = ["axis 1"]\n', 'encoders.nodes: holds "axis 1"; a node id is expected'),
        (OPCUA + NODES.replace('"rad"', '"counts"'), 'angle_unit: is "counts"'),
        (OPCUA + NODES + "rate_hz = 1000.0\n", "rate_hz: is 1000; a number from 0.5 to 200"),
        (
            f'driver = "opcua"\nport = "opc.tcp://me:secret@h:x"\n{NODES}',
            'encoders.port: is "h:x"; an address such as opc.tcp://192.168.0.20:4840',
        ),
        (
            OPCUA + NODES + 'certificate = "own.der"\n',
            "encoders.private_key: is missing; an encrypted channel needs certificate and",
        ),
        (
            OPCUA + NODES + 'security_policy = "None"\n',
            "encoders.certificate: is missing; an encrypted channel needs certificate and",
        ),
        (
            OPCUA + NODES + 'certificate = "c"\nprivate_key = "k"\nsecurity_policy = "Basic256"\n',
            'security_policy: is "Basic256"',
        ),
        (OPCUA + NODES + 'certificate = "c.der"\nprivate_key = "k.pem"\n', "k.pem: no such file"),
        (
            OPCUA + NODES + 'user = "reader"\n',
            'encoders.user: is "reader", whose password is not in the environment',
        ),
        (
            f'driver = "opcua"\nport = "opc.tcp://me:secret@h:1"\nuser = "me"\n{NODES}',
            "encoders.user: is given, and port names a user too",
        ),
    ],
)
def test_settings_of_controllers_have_ranges_and_a_line_each(
    tmp_path: Path, text: str, words: str
) -> None:
    with pytest.raises(InputError, match=re.escape(words)) as problem:
        encoders(tmp_path, text)
    assert str(tmp_path) in str(problem.value)
    assert "secret" not in str(problem.value)


def test_a_users_password_comes_from_the_environment(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("VERIFY_OPCUA_PASSWORD", "secret")
    made = encoders(tmp_path, OPCUA + NODES + 'user = "reader"\n')
    made.open_encoders().close()
    assert made.warnings == ()
    assert "secret" not in repr(made)


def test_bases_follow_on_request_only(tmp_path: Path) -> None:
    pan = '[pan]\ndriver = "serial"\nport = "tcp:127.0.0.1:1"\n'
    still = station(tmp_path, REAL + pan)
    reader = still.open_pan()
    assert isinstance(reader, PanReader)
    assert not isinstance(reader, PanDrive)
    turning = station(tmp_path, REAL + pan + "follow = true\n")
    assert turning.follow
    assert isinstance(turning.open_pan(), PanServo)
    assert isinstance(turning.open_pan(), PanDrive)
    assert turning.facts.turning


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("format = 1", "format = 2", "format is 2; format 1 is expected"),
        ('robot = "iust_6r"', 'robot = "iust_5r"', 'did you mean "iust_6r"'),
        ('rig = "rig.toml"', 'rig = "none.toml"', "none.toml: no such file"),
        ('rig = "rig.toml"', 'rig = "sim"', 'rig: is "sim"'),
        ("source = 0", 'source = "sim"', 'right.source: is not "sim"'),
        ("source = 0", 'source = "/dev/video2"', "right.source: is the left camera's"),
        ("source = 0", "source = -1", "left.source: is -1"),
        ("rate_hz = 30.0", "size = [640, 480]", r"left.size: is 640 x 480; the rig .* 64 x 48"),
        ("rate_hz = 30.0", 'format = "MJPEG"', 'left.format: is "MJPEG"; four letters'),
        ('driver = "labenc"', 'driver = "labnec"', "Did you mean `labenc`"),
        ("tcp:127.0.0.1:10001", "tcp:10001", 'encoders.port: has "10001"; HOST:PORT'),
        ("tcp:127.0.0.1:10001", "foo://x", "encoders.port: invalid URL, protocol 'foo' not known"),
        (
            *("tcp:127.0.0.1:10001", '/dev/ttyUSB0"\nbaud = 99999999999 # "'),
            "encoders.baud: is 99999999999; a whole number of at most 20000000",
        ),
        (
            *('driver = "labenc"', 'driver = "melfa-realtime"'),
            'encoders.port: is "tcp:127.0.0.1:10001"; the stream is UDP',
        ),
        ('driver = "labenc"', 'driver = "labenc"\nparity = "X"', "encoders.parity: is X"),
        ('driver = "labenc"', 'driver = "labenc"\nrate_hz = 0.5', "encoders.rate_hz: is 0.5"),
        ('driver = "labenc"', 'driver = "text"', "encoders, columns: name no q1"),
        (
            *('driver = "labenc"', 'driver = "labenc"\nsign = [1, -1, 1, 1, 1, 2]'),
            r"encoders.sign: is \[1.*2\]; 1 or -1 for each",
        ),
        (
            *('driver = "labenc"', 'driver = "labenc"\nsign = [1]'),
            "encoders.sign: is a list of 1; one for each of the 6 joints",
        ),
        (
            *('driver = "labenc"', 'driver = "labenc"\noffset_deg = [0, 0, 0, 0, 0, nan]'),
            r"encoders.offset_deg\[5\]: is nan; a finite number",
        ),
    ],
)
def test_errors_name_file_and_key(tmp_path: Path, old: str, new: str, words: str) -> None:
    with pytest.raises(InputError, match=words.replace("format is", "format: is")) as problem:
        station(tmp_path, **{old: new})
    assert str(tmp_path) in str(problem.value)


@pytest.mark.parametrize(
    ("more", "words"),
    [
        ("[alarm]\nfalse_alarms_per_hour = 0.0\n", "every test has false alarms"),
        ('[alarm]\nmqtt = "localhost"\n', "mqtt://HOST:PORT/TOPIC"),
        ('[alarm]\nmqtt = "mqtts://localhost/verify"\n', "mqtt://HOST:PORT/TOPIC"),
        ('[alarm]\nmqtt = "mqtt://localhost//"\n', "mqtt://HOST:PORT/TOPIC"),
        ('[alarm]\nmqtt = "mqtt://broker:port/verify"\n', "mqtt://HOST:PORT/TOPIC"),
        ('[alarm]\nmqtt = "mqtt://broker:65536/verify"\n', "mqtt://HOST:PORT/TOPIC"),
        ('[alarm]\nprometheus = "9105"\n', "HOST:PORT is expected"),
        ('[alarm]\nprometheus = "127.0.0.1:65536"\n', "alarm.prometheus: .* a port to 65535"),
        ('[alarm]\nprometheus = "127.0.0.1:99999"\n', "alarm.prometheus: .* a port to 65535"),
        ('[recording]\nname = "../%Y"\n', "a folder's name is expected"),
        ('[recording]\nname = ""\n', "a folder's name is expected"),
        ("[pan]\nfollow = true\n", "pan.follow: is true with fixed bases"),
        ('[pan]\ndriver = "sim"\n', "simulated with their cameras"),
        ('[pan]\ndriver = "serial"\n', "pan.port: is missing"),
        (
            '[pan]\ndriver = "serial"\nport = "COM1"\nbaud = -5\n',
            "pan.baud: is -5; a whole number of 1 or more",
        ),
        ('[[sim.event]]\nwhat = "flood"\nat_s = 1.0\n', r"sim.event\[0\].what"),
    ],
)
def test_what_is_wrong_further_down_too(tmp_path: Path, more: str, words: str) -> None:
    with pytest.raises(InputError, match=words):
        station(tmp_path, REAL + more)


def test_no_camera_stays_open_beside_one_that_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    closed = []

    class Camera:
        def close(self) -> None:
            closed.append(self)

    def open_camera(settings: CameraSettings) -> Camera:
        if settings.source != 0:
            raise InputError("right", "is missing")
        return Camera()

    monkeypatch.setattr(devices, "open_camera", open_camera)
    with pytest.raises(InputError, match="right: is missing"):
        station(tmp_path).open_cameras()
    assert len(closed) == 1


def test_settings_that_do_not_fit_the_simulation_are_refused(tmp_path: Path) -> None:
    text = file.template()
    with pytest.raises(InputError, match=r"encoders.rate_hz: is -5.0; a number above 0"):
        station(tmp_path, text.replace("rate_hz = 100.0", "rate_hz = -5.0"))
    with pytest.raises(InputError, match=r'robot: is "iust_6r"; the simulated robot is "rv_3sd_'):
        station(tmp_path, text.replace('robot = "rv_3sd_melfa"', 'robot = "iust_6r"'))
    with pytest.raises(InputError, match=r"station.toml, sim.scenario: .*no_such"):
        station(tmp_path, text.replace('"multi_joint_rv_3sd"', '"no_such"'))
    event = '[[sim.event]]\nwhat = "encoder_jump"\nat_s = 1.0\njoint = 9\n'
    with pytest.raises(InputError, match=r"sim.event\[0\].joint: is 9"):
        station(tmp_path, text + event)


def test_a_key_that_means_nothing_is_named(tmp_path: Path) -> None:
    made = station(tmp_path, REAL + "pause_ms = 50.0\ntimout_s = 1.0\n[alarm]\nloud = true\n")
    message = "\n".join(made.warnings)
    assert 'encoders.pause_ms: the driver "labenc" has no such setting' in message
    assert "encoders.timout_s: the format does not know this key" in message
    assert "`timeout_s`" in message
    assert "alarm.loud" in message


def test_a_recording_holds_the_stations_settings(tmp_path: Path) -> None:
    from tests.support.devices.recording_process import pair, reading

    more = "time_standard_uncertainty_s = 0.002\n[tolerance]\njoints_deg = 0.5\n"
    more += "[environment]\ntemperature_c = 21.5\n[clock]\nencoder_offset_s = 0.25\n"
    made = station(tmp_path, REAL + more)
    assert isinstance(made.facts, SessionFacts)
    recorder = made.open_recorder()
    recorder.reading(reading(1.0))
    list(recorder.keep(iter([pair(n, 1.0 + n / 30) for n in range(3)])))
    recorder.close()
    folder = recorder.state().folders[-1]
    assert folder.parent == tmp_path / "recordings"
    assert re.fullmatch(r"iust_6r-\d{4}-\d\d-\d\d-\d{6}", folder.name)
    session = open_session(folder)
    assert session.description == "the lab's arm"
    assert session.temperature_c == 21.5
    assert session.encoder_time_standard_uncertainty == 0.002
    assert session.clock == made.watched.clock
    assert (folder / "rig.toml").read_text() == RIG
    assert session.started is not None


def test_a_robots_own_file_goes_with_the_recording(tmp_path: Path) -> None:
    import robots

    library = Path(robots.__file__).parent
    (tmp_path / "arm.toml").write_bytes((library / "iust_6r.toml").read_bytes())
    made = station(tmp_path, **{'robot = "iust_6r"': 'robot = "arm.toml"'})
    assert made.facts.robot == "robot.toml"
    assert made.facts.files["robot.toml"] == (library / "iust_6r.toml").read_bytes()


def test_a_station_to_record_by_needs_neither_rig_nor_marker_and_turns_nothing(
    tmp_path: Path,
) -> None:
    text = file.template().replace('driver = "fixed" ', 'driver = "sim" ')
    text = text.replace("# follow = false", "follow = true")
    path = tmp_path / "station.toml"
    path.write_text(text.replace('rig = "sim"', "").replace('marker = "sim"', ""))
    made = open_recording_station(path, SimulatedStation)
    assert made.rig is None
    assert set(made.facts.files) == set()
    assert any("pan.follow" in warning for warning in made.warnings)
    assert made.facts.turning
    simulated = SimulatedStation(SimSettings()).rig
    (tmp_path / "rig.toml").write_bytes(io_rig.encode(replace(simulated, base_source="")))
    path.write_text(text.replace('rig = "sim"', 'rig = "rig.toml"').replace('marker = "sim"', ""))
    calibrated = open_recording_station(path, SimulatedStation)
    assert calibrated.rig is not None
    assert not calibrated.rig.registered
    assert set(calibrated.facts.files) == {"rig.toml"}
