import numpy as np
import pytest

from tests.support.devices.bench import gather, kept, running, same_angles
from verify.devices.encoders.intake import AngleMap
from verify.devices.encoders.labenc.protocol import MOVING
from verify.devices.encoders.labenc.reader import LabencSettings
from verify.devices.pan import PanReader, PanServo
from verify.simulation.emulators.encoders import LabencOptions, PanEngine
from verify.simulation.emulators.server import EmulatorFaults

OPTIONS = LabencOptions(arm="PANBASE", rate=50, greeting_after=0.05)


@pytest.mark.parametrize(
    ("where", "angles"),
    [("tcp:0", same_angles(2)), ("pty", AngleMap(np.array([1.0, -1.0]), np.deg2rad([2.0, -3.0])))],
)
def test_bases_are_turned_and_their_way_is_marked_as_moving(where: str, angles: AngleMap) -> None:
    with running(PanEngine(OPTIONS), where) as emulated:
        servo = kept(PanServo(LabencSettings(emulated.address), angles))
        gather(servo, lambda found: len(found) >= 3)
        wanted = np.deg2rad([10.0, -5.0])
        assert servo.turn_to(*wanted)
        readings = gather(
            servo, lambda found: bool(found) and not found[-1].moving and found[-1].pan[0] > 0.1
        )
        np.testing.assert_allclose(readings[-1].pan, wanted, atol=2e-6)
        way = [reading for reading in readings if 0.05 < reading.pan[0] < 0.16]
        assert way
        assert all(reading.moving for reading in way)


@pytest.mark.realtime
def test_the_reader_cannot_turn_anything() -> None:
    engine = PanEngine(OPTIONS)
    with running(engine) as emulated:
        reader = kept(PanReader(LabencSettings(emulated.address), same_angles(2)))
        gather(reader, lambda found: len(found) >= 3)
        assert not hasattr(reader, "turn_to")
        with pytest.raises(ValueError, match="may send"):
            reader.send("G", "1", "5.0")
    assert not any(order.startswith("G") for order in engine.log)


@pytest.mark.realtime
def test_a_limit_is_refused_by_the_board_and_reported() -> None:
    with running(PanEngine(OPTIONS)) as emulated:
        servo = kept(PanServo(LabencSettings(emulated.address), same_angles(2)))
        gather(servo, lambda found: len(found) >= 1)
        servo.turn_to(np.deg2rad(80.0), 0.0)
        gather(servo, lambda _: "G,3,axis 1 limit" in servo.state().sentence)
        with pytest.raises(ValueError, match="cannot be turned"):
            servo.turn_to(float("nan"), 0.0)


@pytest.mark.realtime
def test_a_missing_servo_is_reported() -> None:
    with running(PanEngine(OPTIONS), faults=EmulatorFaults(unplug=(0.5, 0.6))) as emulated:
        servo = kept(PanServo(LabencSettings(emulated.address), same_angles(2)))
        gather(servo, lambda found: len(found) >= 1)
        gather(servo, lambda _: not servo.state().connected)
        assert not servo.turn_to(0.1, 0.1)
        gather(servo, lambda found: len(found) >= 1)


@pytest.mark.parametrize(("first", "then"), [(8.22, -13.81), (21.79, 2.49), (-12.02, -4.64)])
def test_a_base_that_has_arrived_is_not_moving_and_stands_where_it_was_sent(
    first: float, then: float
) -> None:
    engine = PanEngine(OPTIONS)
    engine.go(1, first, 0.0)
    engine.go(1, then, 10.0)
    assert engine.status(10.1) == MOVING
    assert engine.status(20.0) == 0
    assert engine.angles(20.0)[0] == np.deg2rad(then)
