import pytest
from hypothesis import given
from hypothesis import strategies as st

from verify.devices.melfa import protocol as r3
from verify.devices.melfa.protocol import ForbiddenCommandError, ReadCommand

AT_REST = "J1;-7.42;J2;38.21;J3;77.74;J4;7.08;J5;61.72;J6;-9.75;;****,****;100;0.00;00000000"
MOVING = "J1;10.90;J2;70.76;J3;64.16;J4;-160.00;J5;40.06;J6;-183.40;;****,****;20;30.28;00000000"
IDLE = ";0;100;0;01120;0;1;;;;;;;;;REP;START;1;0"
RUNNING = "SHOWOF.MB4;11;100;6;60000;11;1;;;;;;;;;REP;START;1;1"
ALARM = "2.MB5;100;100;5;A1124220;1;1;;;;;;;;;REP;START;1;0"
HARMFUL = [
    "OVRD=50", "CNTLON", "CNTLOFF", "SRVON", "SRVOFF", "EXECMOV P1", "EXEC2=MOV P1", "RUN",
    "RUN1;1", "STOP", "CSTOP", "RSTPRG", "SLOTINIT", "PRGLOAD=1", "HNDON1", "HNDOFF1", "MOVSP",
    "JOG00;00;01;00", "HOT1;M1=2", "BREAKONFF", "RSTALRM", "PARMEJAR=1", "PARCBAU232", "OVRD",
    "JPOSF\r1;1;SRVON", "JPOSF;SRVON", "OPEN=A\r1;1;BREAKONFF", "ERRORMES4140;1", "PARMEJAR\r",
    "ERRORMES٤١٤٠", "jposf", "", "STATE ", "EXEC", "SAVE", "LOAD=1", "DELETE1", "JPOS1\n",
]  # fmt: skip


@pytest.mark.parametrize("command", HARMFUL)
def test_a_command_that_does_more_than_read_cannot_be_built(command: str) -> None:
    for end in range(len(command) + 1):  # however it is cut into name and argument
        with pytest.raises(ForbiddenCommandError):
            ReadCommand(command[:end], command[end:])


def test_every_reading_command_has_the_bytes_of_the_manual() -> None:
    assert ReadCommand("JPOSF").encoded(b"\r") == bytes.fromhex("313B313B4A504F53460D")
    assert ReadCommand("OPEN", "=NAME").encoded(b"\r") == b"1;1;OPEN=NAME\r"
    assert ReadCommand("PAR", "MEJAR").encoded(b"\r\n") == b"1;1;PARMEJAR\r\n"
    listed = {"OPEN", "STATE", "JPOSF", "PAR", "ERROR", "ERRORMES", "CLOSE"}
    assert set(r3.READ_COMMANDS) == listed


def test_positions_of_the_traces_are_read() -> None:
    rest, moving = r3.parse_joints(AT_REST, 6), r3.parse_joints(MOVING, 6)
    assert rest.joints_deg == (-7.42, 38.21, 77.74, 7.08, 61.72, -9.75)
    assert (rest.override, rest.speed) == (100, 0.0)
    assert moving.joints_deg == (10.9, 70.76, 64.16, -160.0, 40.06, -183.4)
    assert (moving.override, moving.speed) == (20, pytest.approx(0.03028))


def test_eight_axes_are_read_by_label() -> None:
    eight = AT_REST.replace(";;", ";J7;0.00;J8;0.00;;", 1)
    assert r3.parse_joints(eight, 6) == r3.parse_joints(AT_REST, 6)
    turned = "J2;38.21;J1;-7.42;" + AT_REST.split("38.21;", 1)[1]
    assert r3.parse_joints(turned, 6) == r3.parse_joints(AT_REST, 6)


@pytest.mark.parametrize("text", [AT_REST, MOVING])
def test_no_part_of_a_position_passes_for_a_whole_one(text: str) -> None:
    for length in range(len(text)):
        assert r3.parse_joints(text[:length], 6) is None
    assert r3.parse_joints(text + "0", 6) is None
    assert r3.parse_joints(text.replace("J2", "J1"), 6) is None
    assert r3.parse_joints(text, 7) is None


@given(st.binary(max_size=200))
def test_bytes_that_are_no_answer_are_none(data: bytes) -> None:
    answer = r3.parse_answer(data)
    if answer is not None:
        assert data[:3] in (b"QoK", b"Qok", b"QeR", b"Qer")
        r3.parse_state(answer.data)
        r3.parse_error(answer.data)
        r3.parse_joints(answer.data, 6)


@given(st.integers(0, len(AT_REST) - 1), st.characters(max_codepoint=127))
def test_a_changed_character_gives_none_or_the_changed_value(at: int, character: str) -> None:
    changed = AT_REST[:at] + character + AT_REST[at + 1 :]
    position = r3.parse_joints(changed, 6)
    if position is not None:
        written = changed.split(";;")[0].split(";")
        output = dict(zip(written[::2], map(float, written[1::2]), strict=True))
        assert position.joints_deg == tuple(output[f"J{joint}"] for joint in range(1, 7))


def test_status_and_errors_are_distinguished() -> None:
    refused = r3.parse_answer(bytes.fromhex("516552363032 30".replace(" ", "")))
    assert refused == r3.ControllerAnswer(False, 6020, "")
    assert r3.ERROR_MEANINGS[6020] == "no operation right"
    assert r3.parse_answer(b"Qok4140;2") == r3.ControllerAnswer(True, None, "4140;2")
    assert r3.parse_error("4140;2") == 4140
    assert r3.parse_error("") is None
    assert r3.parse_answer(b"QeR") is None


def test_run_states_of_the_traces_are_read() -> None:
    idle, running, alarm = map(r3.parse_state, (IDLE, RUNNING, ALARM))
    assert (idle.running, idle.servo_on, idle.error) == (False, False, 0)
    assert (running.running, running.servo_on) == (True, True)
    assert (alarm.running, alarm.servo_on, alarm.error) == (False, True, 4220)
    assert r3.parse_state(AT_REST) is None
