import re
import socket
from pathlib import Path

import numpy as np
import pytest

from tests.support.command import verify
from tests.support.devices.bench import emulate_command, gather, kept, same_angles
from verify.devices.encoders.labenc.reader import LabencEncoders, LabencSettings
from verify.devices.melfa import protocol
from verify.devices.ports import SerialLine
from verify.errors import InputError
from verify.simulation.emulators import endpoints, server, trajectory
from verify.simulation.emulators.arm import MelfaArm
from verify.simulation.emulators.encoders import LabencEngine, LabencOptions
from verify.simulation.emulators.melfa import ControllerOptions, MelfaEngine

LIMITS = np.tile([-3.0, 3.0], (6, 1))


def reply(engine: MelfaEngine, command: str, t: float = 1.0) -> str:
    """One command's answer at t; the engine waits a while for a terminator."""
    (message,) = engine.step(t, f"1;1;{command}\r".encode())
    return message.data.decode().strip()


def controller(opened: bool = True) -> MelfaEngine:
    hold = trajectory.load("hold", 6)
    engine = MelfaEngine(MelfaArm(hold, LIMITS), ControllerOptions())
    if opened:
        reply(engine, "OPEN=test", 0.5)
    return engine


@pytest.mark.parametrize(
    ("command", "answer"),
    [
        ("NOSUCH", "QeR6010"), ("BREAKONFF", "QeR6010"), ("\x07", "QeR4220"),
        ("X" * 260, "QeR6080"),
        ("SRVON", "QeR6020"), ("OVRD=10", "QeR6020"), ("EXECMOV P1", "QeR6020"), ("OVRD", "QoK100"),
        ("ERROR", "QoK"), ("EMISS", "QeR5990"), ("STOP", "QoK"),
    ],
)  # fmt: skip
def test_a_controller_refuses_as_in_the_manual(command: str, answer: str) -> None:
    assert reply(controller(), command) == answer


def test_a_controller_before_open_with_right_without_servo_in_alarm() -> None:
    engine = controller(opened=False)
    assert reply(engine, "STATE") == "QeR6500"
    assert reply(engine, "OPEN=a").startswith("QoK3F;3F;")
    assert reply(engine, "CNTLON") == "QoK"
    assert reply(engine, "SRVOFF") == "QoK"
    assert reply(engine, "EXECMOV P1") == "QeR2000"
    assert reply(engine, "OVRD=10") == "QoK"
    assert reply(engine, "OVRD") == "QoK10"
    assert reply(engine, "SRVON", 2.0) == "QoK"
    state = protocol.parse_state(reply(engine, "STATE", 2.1).removeprefix("QoK"))
    assert not state.servo_on
    state = protocol.parse_state(reply(engine, "STATE", 4.0).removeprefix("QoK"))
    assert state.servo_on
    engine.afflict("alarm", 4140)
    assert reply(engine, "ERROR") == "Qok4140;2"
    assert reply(engine, "RUN") == "Qer5600"
    assert reply(engine, "RSTALRM") == "QoK"


def test_robot_and_slot_may_be_left_out() -> None:
    for prefix in ("1;1;", ";;", "", "1;9;"):
        (message,) = controller().step(1.0, f"{prefix}JPOSF\r".encode())
        assert message.data == (
            b"QoKJ1;0.00;J2;20.00;J3;70.00;J4;10.00;J5;40.00;J6;0.00;;****,****;100;0.00;00000000\r"
        )


def test_a_boards_ceiling_and_queries_are_those_of_the_sheet() -> None:
    board = LabencEngine(trajectory.load("hold", 6), 6, LabencOptions(boot_noise=b""))
    first = board.step(0.31, b"$R,100*4F\n$R,105*4A\n$T,17*7E\n$Q*00\n")
    text = b"".join(message.data for message in first).decode().split("\n")
    assert text[0] == "$H,LABENC,1.0,IUST6R,6,deg,1000000,100,0123ABCD*4B"
    assert text[1] == "$A,R,100*22"
    assert text[2] == "$E,R,2,bad rate*4C"
    assert text[3].startswith("$T,17,310000,310000*")
    assert text[4] == "$E,?,1,checksum*6A"


def test_motions_are_smooth_and_a_recorded_one_is_played_to_and_fro(tmp_path: Path) -> None:
    t = np.arange(0.0, 30.0, 0.01)
    for name in trajectory.NAMES:
        motion = trajectory.load(name, 6)
        q = np.array([motion(s) for s in t.tolist()])
        assert np.max(np.abs(np.diff(q, axis=0))) < 0.01
    path = tmp_path / "motion.csv"
    path.write_text("t_s,q1_deg\n5.0,0.0\n6.0,10.0\n7.0,20.0\n")
    recorded = trajectory.load(str(path), 1)
    found = [np.rad2deg(recorded(s))[0] for s in (0.0, 1.0, 2.0, 3.0, 4.0, 5.0)]
    np.testing.assert_allclose(found, [0, 10, 20, 10, 0, 10], atol=1e-9)
    with pytest.raises(InputError, match="hold, sweep, sines"):
        trajectory.load("jive", 6)


def test_faults_are_read_or_refused() -> None:
    known = frozenset({"noise", "silence", "reset"})
    read = server.parse_faults(["noise=0.1", "silence=10:3", "reset=20"], known)
    assert read == server.EmulatorFaults(noise=0.1, silence=(10.0, 3.0), reset=(20.0, 20.0))
    for wrong in ("jump=1:2", "noise=2", "noise", "silence=3", "reset=a", "reset=nan"):
        with pytest.raises(InputError, match="--fault"):
            server.parse_faults([wrong], known)


@pytest.mark.parametrize(
    ("device", "fault"),
    [
        ("gripper", "alarm=1:16"), ("melfa", "alarm=1:-5"), ("labenc", "status=1:70000"),
        ("opcua", "jump=1:1e12"), ("rtde", "silence=1:-3"),
    ],
)  # fmt: skip
def test_a_fault_beyond_what_the_device_can_tell_is_refused(device: str, fault: str) -> None:
    line = verify("emulate", device, "--port", "tcp:0", "--fault", fault).refusal
    assert re.search(rf'--fault: "{re.escape(fault)}"; a value from .* to .* is expected', line)


@pytest.mark.parametrize(
    ("device", "port", "kind"),
    [
        ("melfa-realtime", "tcp:0", "udp"), ("melfa-realtime", "pty", "udp"),
        ("rtde", "udp:0", "tcp"), ("rosbridge", "pty", "tcp"), ("opcua", "udp:0", "tcp"),
    ],
)  # fmt: skip
def test_a_device_on_another_kind_of_line_is_refused(device: str, port: str, kind: str) -> None:
    line = verify("emulate", device, "--port", port).refusal
    assert f"--port {port}: is another kind of line; {device} is reached at {kind}:PORT" in line


@pytest.mark.parametrize(
    ("device", "option"),
    [
        ("gripper", "--motion hold"), ("pan", "--joints 3"), ("pan", "--motion hold"),
        ("melfa", "--rate 50"), ("gripper", "--rate 50"), ("opcua", "--baud 9600"),
        ("opcua", "--seed 1"), ("rosbridge", "--joints 7 --robot ur5"),
    ],
)  # fmt: skip
def test_an_option_that_the_device_does_not_have_is_refused(device: str, option: str) -> None:
    line = verify("emulate", device, *option.split(), "--fault", "none").refusal  # never serves
    assert line.startswith(f"error: {option.split()[0]}: {device} ")
    assert line.endswith("Leave it out.")


def test_a_controller_of_another_number_of_joints_answers_or_is_refused() -> None:
    assert "--joints: is 7; every arm" in verify("emulate", "rtde", "--joints", "7").refusal
    with (
        emulate_command("melfa", "--joints", "8", "--port", "tcp:0", "--motion", "hold") as address,
        socket.create_connection(("127.0.0.1", int(address.rpartition(":")[2]))) as client,
    ):
        for command, label in ((b"OPEN=x", b";MELFA;"), (b"JPOSF", b";J8;")):
            client.sendall(b"1;1;" + command + b"\r")
            assert label in client.recv(4096)


def test_a_pseudo_terminals_link_takes_no_files_place(tmp_path: Path) -> None:
    mine, link, left = tmp_path / "notes.txt", tmp_path / "mine", tmp_path / "left"
    mine.write_text("keep")
    link.symlink_to(mine)
    left.symlink_to("/dev/pts/999")  # of an emulator that was killed
    for path in (mine, link):
        assert "file exists" in verify("emulate", "labenc", "--port", f"pty:{path}").refusal
        assert path.read_text() == "keep"
    front = endpoints.open_front(f"pty:{left}", SerialLine())
    assert left.exists()
    front.unplug()
    assert not left.is_symlink()


def test_a_front_that_cannot_be_opened_is_refused() -> None:
    for where in ("tcp:x", "/dev/there-is-none"):
        with pytest.raises(InputError):
            endpoints.open_front(where, SerialLine())


@pytest.mark.parametrize("where", ["tcp:0", "pty"])
def test_the_command_prints_its_address_and_ends_at_ctrl_c(where: str) -> None:
    with emulate_command("labenc", "--port", where, "--motion", "sweep") as address:
        encoders = kept(LabencEncoders(LabencSettings(address), same_angles(6)))
        readings = gather(encoders, lambda found: len(found) >= 10)
        assert np.ptp([reading.q for reading in readings]) > 0
    if where == "pty":
        assert not Path(address).exists()
