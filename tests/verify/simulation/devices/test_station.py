"""Simulated devices keep the promises of the real ones, and show the world that they share."""

import time
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from tests.support.devices.bench import gather
from verify.core.records import Image
from verify.devices.protocols import READ_TIMEOUT, CameraFrame, CameraSettings
from verify.errors import InputError
from verify.live.station.keys import SimEvent, SimSettings
from verify.measurement.detection.detect import detect
from verify.simulation.devices.cameras import SimulatedCameraDevice
from verify.simulation.devices.painting import Painter, PeriodicMotion, RenderRequest
from verify.simulation.devices.scene import SimClock
from verify.simulation.devices.station import SimulatedStation

SCENARIO = "multi_joint_rv_3sd"
SIM = CameraSettings("sim", rate=30.0)


class HandClock:
    """A host's clock that stands still until somebody sleeps."""

    def __init__(self) -> None:
        self.t = 100.0

    def now(self) -> float:
        return self.t

    def sleep(self, seconds: float) -> None:
        assert seconds >= 0
        self.t += min(seconds, 1e6)


def station(
    *events: SimEvent, speed: float = 1.0, hand: HandClock | None = None
) -> SimulatedStation:
    hand = hand or HandClock()
    clock = SimClock(speed, hand.now, hand.sleep)
    return SimulatedStation(SimSettings(SCENARIO, speed, events), clock)


def frames(camera: Any, seconds: float, made: SimulatedStation) -> list[CameraFrame]:
    """What comes within so many simulated seconds."""
    end, taken = made.scene.clock.now() + seconds, []
    while made.scene.clock.now() < end:
        if (frame := camera.read()) is not None:
            taken.append(frame)
    return taken


def test_pictures_come_at_their_rate_each_once() -> None:
    made = station()
    left, right = made.camera(0, SIM), made.camera(1, SIM)
    pictures = frames(left, 1.0, made)
    assert len(pictures) == pytest.approx(30, abs=1)
    assert_allclose(np.diff([p.t for p in pictures]), 1 / 30, atol=1e-9)
    assert [p.sequence for p in pictures] == list(range(len(pictures)))
    assert pictures[0].image.shape == (720, 1280)
    assert left.state().connected
    assert left.state().lost == 0
    assert right.state().age is None


class Busy:
    """Paints so late, as a machine does that has other things to do."""

    trouble = ""

    def __init__(self, hand: HandClock, near: Painter, *, late: float) -> None:
        self._hand, self._near, self.late = hand, near, late
        self.meanwhile = lambda: None

    def paint(self, sight: RenderRequest) -> Image:
        self._hand.t += self.late
        self.meanwhile()
        return self._near.paint(sight)

    def close(self) -> None: ...


def test_a_camera_whose_pictures_come_late_is_not_silent() -> None:
    hand = HandClock()
    made = station(hand=hand)
    painter = Busy(hand, made.scene.painter, late=0.45)
    camera = SimulatedCameraDevice(made.scene, 0, painter, SIM)
    ages: list[float | None] = []
    painter.meanwhile = lambda: ages.append(camera.state().age)
    numbers = []
    for _ in range(5):
        frame = camera.read()
        numbers.append(frame.sequence)
        age = camera.state().age
        assert age is not None
        assert age < 1 / 30
    assert len(ages) == 5
    assert all(age is not None and age <= 1 / 30 for age in ages)
    assert hand.t - frame.t > 0.4
    assert numbers[-1] - numbers[-2] == 16  # of thirty a second
    hand.t += 1.5
    assert camera.state().age == pytest.approx(1.5)


def test_two_cameras_that_are_late_differently_still_show_the_same_instants() -> None:
    shown = []
    for side, late in enumerate((0.41, 0.67)):  # 12 and 20 pictures
        hand = HandClock()
        made = station(hand=hand)
        painter = Busy(hand, made.scene.painter, late=late)
        camera = SimulatedCameraDevice(made.scene, side, painter, SIM)
        pictures = frames(camera, 60.0, made)
        numbers = [picture.sequence for picture in pictures]
        assert camera.state().lost == numbers[-1] + 1 - len(numbers)
        assert len(numbers) > 0.5 * 60.0 / late
        shown.append(set(numbers))
    assert len(shown[0] & shown[1]) > 0.9 * len(shown[1])


def test_pictures_show_the_leds_where_the_world_has_them() -> None:
    made = station()
    for side in range(2):
        picture = frames(made.camera(side, SIM), 0.1, made)[0]
        camera = made.scene.world.bench.cameras[side]
        points = made.scene.world.led_points(np.array(made.scene.seconds(picture.t)))
        seen = camera.project(points, float(made.scene.pan(picture.t)[side]))
        found = detect(picture.image).centre
        apart = np.linalg.norm(found[:, None] - seen, axis=-1)
        assert apart.min(axis=0).max() < 0.3
        assert len(found) == 4


def test_readings_are_the_arms_angles_on_the_controllers_clock() -> None:
    made = station()
    encoders = made.encoders(100.0)
    readings = gather(encoders, lambda found: len(found) >= 200)
    offset = made.scene.scenario.encoders.clock_offset_s
    t = np.array([r.t for r in readings]) + offset
    q = np.array([r.q for r in readings])
    assert_allclose(np.diff(t), 0.01, atol=1e-9)
    assert_allclose(
        q, made.scene.world.joints(made.scene.seconds(t)), atol=np.deg2rad(0.03)
    )  # noise of 0.005°
    assert all(r.t_host >= instant for r, instant in zip(readings, t, strict=True))
    assert len(readings) == 200


def test_events_count_from_the_first_device_on_however_long_the_start_took() -> None:
    made = station(SimEvent("encoder_reset", 2.0), SimEvent("lamp_on", 1.0, 0.5))
    clock = made.scene.clock
    clock.wait_until(clock.began + 7.0, 100.0)
    made.encoders(100.0)
    opened = clock.now()
    clock.wait_until(opened + 0.5, 100.0)
    made.camera(0, SIM)
    assert [made.scene.happens("lamp_on", opened + t) for t in (0.9, 1.2, 1.6)] == [
        False,
        True,
        False,
    ]
    assert made.scene.resets(opened + 1.9) == []
    assert made.scene.resets(opened + 2.1) == pytest.approx([opened + 2.0])


def test_a_jump_appears_in_its_joint_from_its_instant_on() -> None:
    jump = np.deg2rad(0.5)
    made = station(SimEvent("encoder_jump", 1.0, joint=4, degrees=0.5))
    encoders, began = made.encoders(100.0), made.scene.clock.began
    readings = gather(encoders, lambda found: len(found) >= 200)
    t = np.array([r.t for r in readings]) + made.scene.scenario.encoders.clock_offset_s
    error = np.array([r.q for r in readings]) - made.scene.world.joints(made.scene.seconds(t))
    after = t - began >= 1.0
    assert_allclose(error[after].mean(axis=0), [0, 0, 0, jump, 0, 0], atol=2e-5)
    assert_allclose(error[~after].mean(axis=0), 0, atol=2e-5)


def test_a_reset_controller_begins_a_segment() -> None:
    made = station(SimEvent("encoder_reset", 0.5))
    encoders = made.encoders(100.0)
    readings = gather(encoders, lambda found: len(found) >= 100)
    segments = np.array([r.segment for r in readings])
    assert set(segments) == {0, 1}
    t = np.array([r.t for r in readings])
    assert np.all(np.diff(t[segments == 1]) > 0)
    assert t[segments == 1][0] < 2.0 < t[0]


@pytest.mark.parametrize("what", ["camera_gone", "camera_stalls"])
def test_a_camera_that_fails_is_silent_and_comes_back(what: str) -> None:
    made = station(SimEvent(what, 0.5, 1.0, camera="left"))
    left, right = made.camera(0, SIM), made.camera(1, SIM)
    before = frames(left, 0.5, made)
    during = frames(left, 0.9, made)
    message = left.state()
    after = frames(left, 0.7, made)
    assert before
    assert after
    assert not during
    assert message.connected == (what == "camera_stalls")
    assert ("unplugged" if what == "camera_gone" else "silent") in message.sentence
    assert right.state().connected
    assert after[0].sequence - before[-1].sequence > 25
    assert left.state().connected


def test_covered_leds_are_dark_and_a_lamp_is_a_light_more() -> None:
    made = station(SimEvent("leds_covered", 1.0, 1.0), SimEvent("lamp_on", 3.0, 1.0))
    camera, began = made.camera(0, SIM), made.scene.clock.began
    seen = {
        round((p.t - began) * 30): len(detect(p.image).centre) for p in frames(camera, 4.5, made)
    }
    assert seen[20] == seen[80] == 4
    assert seen[45] == 0
    assert seen[100] == 5


def test_one_led_can_be_covered_for_one_camera() -> None:
    made = station(SimEvent("leds_covered", 0.0, camera="right", led="B"))
    counts = [
        len(detect(frames(made.camera(side, SIM), 0.1, made)[0].image).centre) for side in range(2)
    ]
    assert counts == [4, 3]


def test_bases_turn_at_their_speed_and_report_motion() -> None:
    made = station()
    pan = made.pan()
    start = pan.read()[-1].pan
    assert pan.turn_to(*(start + np.deg2rad([10.0, -5.0])))
    readings = gather(pan, lambda found: len(found) >= 50)
    moving = np.array([r.moving for r in readings])
    angles = np.array([r.pan for r in readings])
    assert moving[1]
    assert not moving[-1]
    assert np.count_nonzero(moving) == pytest.approx(25, abs=2)  # 10° at 20°/s, 50 a second
    assert_allclose(angles[-1], start + np.deg2rad([10.0, -5.0]))
    assert pan.turn_to(2.0, 0.0)
    assert "refused" in pan.state().sentence


def test_bases_that_have_arrived_are_at_rest_where_they_were_sent() -> None:
    made = station()
    for wanted in np.deg2rad([[8.22, 21.79], [-13.81, 2.49]]):
        made.scene.turn(wanted)
        gather(made.pan(), lambda found: len(found) >= 120)  # 2.4 s: longer than the way
    angles, moving = made.scene.pan_reading(made.scene.clock.now())
    assert not moving
    assert_array_equal(angles, wanted)


def test_missing_bases_report_nothing_and_accept_nothing() -> None:
    made = station(SimEvent("pan_gone", 0.1, 1.0))
    pan = made.pan()
    readings = []
    while made.scene.clock.now() < made.scene.clock.began + 1.0:
        readings += pan.read()
    assert readings[-1].t <= made.scene.clock.began + 0.1
    assert not pan.turn_to(0.0, 0.0)
    assert not pan.state().connected


def test_the_world_can_run_faster_than_the_host() -> None:
    made = station(speed=10.0)
    begin = made.scene.clock._now()
    pictures = frames(made.camera(0, SIM), 2.0, made)
    assert len(pictures) == pytest.approx(60, abs=2)
    assert made.scene.clock._now() - begin == pytest.approx(0.2, abs=0.05)


@pytest.mark.realtime
def test_read_keeps_its_limits_in_real_time() -> None:
    made = SimulatedStation(
        SimSettings(
            SCENARIO, events=(SimEvent("camera_stalls", 0.0), SimEvent("encoder_silent", 0.0))
        )
    )
    for read, limit in (
        (made.camera(0, SIM).read, READ_TIMEOUT),
        (made.camera(1, CameraSettings("sim", rate=0.5)).read, READ_TIMEOUT),
        (made.encoders(100.0).read, 0.02),
        (made.pan().read, 0.02),
    ):
        begin = time.monotonic()
        read()
        assert time.monotonic() - begin < limit + 0.1  # 0.1 s: a busy machine


def test_settings_that_mean_nothing_to_a_simulation_are_refused() -> None:
    asked = CameraSettings("sim", size=(640, 480), exposure=0.005, gain=2.0)
    refused = station().camera(0, asked).state().refused
    assert {r.setting for r in refused} == {"size", "exposure", "gain"}


def test_an_endless_motion_is_smooth_and_stays_on_its_way() -> None:
    made = station()
    motion = made.scene.world.motion
    assert isinstance(motion, PeriodicMotion)
    t = np.arange(0.0, 30.0, 0.001)
    q = motion.angles(t)
    planned = motion.motion.angles(np.linspace(motion.begin, motion.end, 5000))
    assert np.all(q.max(axis=0) <= planned.max(axis=0) + 1e-6)
    assert np.all(q.min(axis=0) >= planned.min(axis=0) - 1e-6)
    assert np.abs(np.diff(q, 2, axis=0)).max() < 1e-4  # rad: no speed leaps at the turns
    moving = np.abs(np.diff(q, axis=0)) > 1e-6
    way = np.sign(np.diff(q, axis=0))
    agree = way == motion.direction(t[:-1] + 0.0005)
    assert np.mean(agree[moving]) > 0.999


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        (SimSettings("boards_fixed"), "shows boards"),
        (SimSettings(SCENARIO, events=(SimEvent("encoder_jump", 1.0),)), "is missing"),
        (SimSettings(SCENARIO, events=(SimEvent("leds_covered", 1.0, led="Z"),)), "A, B, C, D"),
    ],
)
def test_settings_that_cannot_be_simulated_are_refused(settings: SimSettings, words: str) -> None:
    with pytest.raises(InputError, match=words):
        SimulatedStation(settings)
