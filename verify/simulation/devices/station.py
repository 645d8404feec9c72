"""The simulated station: one world that its cameras, encoders and bases look at, as they run."""

from verify.core.fiducials import Marker
from verify.core.rig import Rig
from verify.devices.protocols import CameraSettings
from verify.errors import InputError
from verify.live.station.keys import SimEvent, SimSettings
from verify.simulation import library
from verify.simulation.devices.cameras import SimulatedCameraDevice
from verify.simulation.devices.encoders import SimulatedEncoders, SimulatedPan
from verify.simulation.devices.painting import Painter, RemotePainter, build_painter
from verify.simulation.devices.scene import DeviceScene, SimClock
from verify.simulation.scenario import BoardScenario
from verify.simulation.session.simulate import simulate_session


class SimulatedStation:
    """Simulated hardware behind the same Protocols as the real one.

    The scenario's motion goes to and fro without end. Its time begins when this is made. `apart`:
    pictures are painted in a process of their own.

    Raises:
        InputError: no such scenario, or one that contradicts itself or the events.
    """

    def __init__(
        self, settings: SimSettings, clock: SimClock | None = None, *, apart: bool = False
    ) -> None:
        scenario = library.load(settings.scenario)
        if isinstance(scenario, BoardScenario):
            found = f'"{settings.scenario}" shows boards'
            raise InputError("sim.scenario", found, "one with a robot is expected", "Name another.")
        session = simulate_session(scenario)
        _check(settings.events, session.world.arm.dof, session.marker.names)
        self.robot = scenario.robot
        self.rig: Rig = session.rig
        self.marker: Marker = session.marker
        near = build_painter(session)
        self._painter: Painter = RemotePainter(settings.scenario, near) if apart else near
        self.scene = DeviceScene(session, near, clock or SimClock(settings.speed), settings.events)

    def camera(self, side: int, settings: CameraSettings) -> SimulatedCameraDevice:
        """Open the left (0) or right (1) camera."""
        self.scene.open()
        return SimulatedCameraDevice(self.scene, side, self._painter, settings)

    def encoders(self, rate: float | None) -> SimulatedEncoders:
        """Open the encoders; rate in Hz, None for the scenario's own."""
        self.scene.open()
        return SimulatedEncoders(self.scene, rate)

    def pan(self) -> SimulatedPan:
        """Open the turning bases."""
        self.scene.open()
        return SimulatedPan(self.scene)


def _check(events: tuple[SimEvent, ...], joints: int, leds: tuple[str, ...]) -> None:
    for index, event in enumerate(events):
        if event.what == "encoder_jump" and event.joint not in range(1, joints + 1):
            found = "is missing" if event.joint is None else f"is {event.joint}"
            expected = f"a joint from 1 to {joints} is expected"
            raise InputError(f"sim.event[{index}].joint", found, expected, "Correct it there.")
        if event.led is not None and event.led not in leds:
            expected = f"the LEDs are {', '.join(leds)}"
            raise InputError(
                f"sim.event[{index}].led", f'is "{event.led}"', expected, "Correct it there."
            )
