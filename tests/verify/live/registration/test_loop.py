"""A recording's state: what it says of its devices."""

import threading
import time
from pathlib import Path

import robots
from verify.devices.protocols import CameraFrame, CameraState, DeviceState, EncoderReading
from verify.live.protocols import LiveDevices
from verify.live.recording.recorder import SessionRecorder
from verify.live.recording.session import SessionFacts
from verify.live.registration.loop import RecordingLoop
from verify.live.registration.show import RecordingSnapshot, RecordingState


class StillCamera:
    def read(self) -> CameraFrame | None:
        time.sleep(0.01)
        return None

    def state(self) -> CameraState:
        return CameraState(True, 0.0, 0, "reading")

    def close(self) -> None:
        pass


class BrokenEncoders:
    def read(self) -> list[EncoderReading]:
        time.sleep(0.01)
        raise ZeroDivisionError("oh")

    def state(self) -> DeviceState:
        return DeviceState(True, 0.0, 0, {}, "reading")

    def close(self) -> None:
        pass


def test_a_device_whose_thread_fails_has_one_line_and_is_not_well(tmp_path: Path) -> None:
    state, stop = RecordingState(RecordingSnapshot()), threading.Event()
    recorder = SessionRecorder(tmp_path, "s", SessionFacts("rv_3sd", 6, {}, {}, False))
    devices = LiveDevices(StillCamera(), StillCamera(), BrokenEncoders())
    loop = RecordingLoop(robots.load("rv_3sd"), None, devices, recorder, state, lambda _: None)
    defects = loop.run(stop, 0.5, lambda: None)
    lines = state.snapshot().devices
    assert [line.name for line in lines] == ["left camera", "right camera", "encoders"]
    assert [line.well for line in lines] == [True, True, False]
    assert lines[2].sentence == "a defect of this program, ZeroDivisionError: oh"
    assert defects == (f"The encoders has failed: {lines[2].sentence}",)
