"""A simulated camera: looks at the world at its rate, in real time or faster."""

import numpy as np

from verify.core.records import SIDES, Image
from verify.devices.cameras.opencv import one_channel
from verify.devices.protocols import (
    READ_TIMEOUT,
    CameraFrame,
    CameraSettings,
    CameraState,
    RefusedSetting,
)
from verify.simulation.devices.painting import Painter, RenderRequest
from verify.simulation.devices.scene import DeviceScene
from verify.simulation.world.motion import RandomStream, generator

MAX_BUFFERED = 4  # pictures that a camera's driver holds for a slow reader
TRANSFER_TIME = 0.002  # s, from the end of the exposure to the picture in hand
RENDER_TIME = 0.016  # s: so long before a picture is due its rendering begins


class SimulatedCameraDevice:
    """The left (0) or right (1) camera.

    The next picture is rendered shortly before it is due: a real camera, too, costs its reader
    nothing until the picture is there, nor the measurement of the one before.
    """

    def __init__(
        self, scene: DeviceScene, side: int, painter: Painter, settings: CameraSettings
    ) -> None:
        self._painter = painter
        self._scene, self._side, self._settings = scene, side, settings
        recording = scene.scenario.recording
        self._rate = settings.rate or recording.rate_hz
        self._skew = recording.skew_s if side else 0.0
        self._jitter = recording.skew_jitter_s if side else 0.0
        self._chance = generator(scene.scenario.seed, RandomStream.TIMES, 1 + side)
        self._exposure = scene.world.bench.cameras[side].exposure
        self._next = self._due(scene.clock.now())  # number of the next picture
        self._last = self._next - 1
        self._took = (0.0, 0.0)  # s: the last two renderings
        self._ready: CameraFrame | None = None
        self._lost = 0
        self._arrival: float | None = None  # s, of the last picture
        self._coming = self._closed = False

    def read(self) -> CameraFrame | None:
        """Give the next picture; None after READ_TIMEOUT without one."""
        clock = self._scene.clock
        if self._away() is not None:
            clock.wait_until(float("inf"), READ_TIMEOUT / 10)  # soon enough to see it come back
            self._ready = None
            self._next = self._due(clock.now())
            self._last = self._next - 1
            return None
        self._coming = True
        try:
            return self._coming_next()
        finally:
            self._coming = False

    def _coming_next(self) -> CameraFrame | None:
        clock = self._scene.clock
        if self._ready is None:
            self._next = self._shared(max(self._next, self._due(clock.now()) - MAX_BUFFERED))
            begin = clock.began + self._next / self._rate - RENDER_TIME
            if not clock.wait_until(begin, READ_TIMEOUT):
                return None
            self._ready = self._take()
        arrival = self._ready.t + self._exposure / 2 + TRANSFER_TIME
        if not clock.wait_until(arrival, READ_TIMEOUT):
            return None
        frame, self._ready = self._ready, None
        self._arrival = clock.now()
        return frame

    def state(self) -> CameraState:
        """Say how the camera is."""
        now, away = self._scene.clock.now(), self._away()
        age = None if self._arrival is None else now - self._arrival
        if self._coming and away is None:  # this machine may be late: the camera it plays is not
            age = min(age or 0.0, 1 / self._rate)
        name = f"simulated {SIDES[self._side]} camera"
        conditions = {"camera_gone": "not connected: it was unplugged", "camera_stalls": "silent"}
        notes = [str(refusal) for refusal in self._refused()]
        late = f"{self._lost} pictures that were not rendered, or not read, in time"
        notes += [late] if self._lost else []
        notes += [self._painter.trouble] if self._painter.trouble else []
        return CameraState(
            connected=away != "camera_gone" and not self._closed,
            age=age,
            lost=self._lost,
            sentence="; ".join([f"{name}: {conditions.get(away or '', 'reading')}", *notes]),
            refused=self._refused(),
        )

    def close(self) -> None:
        """Let go of the camera."""
        self._closed = True
        self._painter.close()

    def _away(self) -> str | None:
        """What keeps pictures from coming, if anything."""
        for event in self._scene.present():
            if event.what in ("camera_gone", "camera_stalls") and event.strikes(self._side):
                return event.what
        return None

    def _due(self, t: float) -> int:
        """Number of the first picture after an instant."""
        return max(int(np.ceil((t - self._scene.clock.began) * self._rate)), 0)

    def _take(self) -> CameraFrame:
        """Render the next picture; those that a slow reader missed are gone."""
        clock, number = self._scene.clock, self._next
        self._lost += number - self._last - 1
        t = clock.began + number / self._rate + self._skew
        t += self._jitter * float(self._chance.standard_normal())
        began = clock.now()
        image = self._picture(t, number)
        self._took = (self._took[1], clock.now() - began)
        self._last, self._next = number, number + 1
        return CameraFrame(t, 0.0, image, None, number)

    def _shared(self, number: int) -> int:
        """Number of a picture, this one or a later one, that the other camera renders too.

        Where rendering goes on taking longer than from picture to picture, only every second is
        rendered, or fourth, eighth: of two cameras that are late by much, each by its own time, the
        one shows all instants that the other shows.
        """
        pictures = int(min(self._took) * self._rate)
        stride = 1 << max(pictures - 1, 0).bit_length()
        return number + -number % stride

    def _picture(self, t: float, number: int) -> Image:
        scene, side = self._scene, self._side
        pan = float(scene.pan(t)[side])
        hidden = scene.hidden(t, side)
        image = self._painter.paint(
            RenderRequest(side, scene.seconds(t), pan, scene.happens("lamp_on", t), hidden, number)
        )
        return one_channel(image, self._settings.grey)

    def _refused(self) -> tuple[RefusedSetting, ...]:
        """Settings that a simulation has no use for, and a size that is not the scenario's."""
        settings, size = self._settings, self._scene.scenario.rig.image_size
        refused = [
            RefusedSetting(name, str(value), "not simulated")
            for name in ("format", "exposure", "gain", "white_balance")
            if (value := getattr(settings, name)) is not None
        ]
        if settings.size not in (None, size):
            refused.append(
                RefusedSetting("size", "{} x {}".format(*settings.size), "{} x {}".format(*size))
            )
        return tuple(refused)
