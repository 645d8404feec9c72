"""Simulated cameras before which a board is carried about: put down, held still, carried on."""

import threading
from collections import deque
from concurrent.futures import Future, ThreadPoolExecutor, wait
from dataclasses import dataclass, replace
from math import floor

import msgspec
import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from verify.core.fiducials import Board
from verify.core.records import SIDES, Array, Image, rigid_transform
from verify.devices import protocols
from verify.errors import InputError
from verify.live.station.keys import SimSettings
from verify.simulation import library
from verify.simulation.boards.simulate import SimulatedBoards, simulate_boards
from verify.simulation.devices.encoders import PAN_RATE, SimulatedReadings
from verify.simulation.devices.scene import SimClock
from verify.simulation.scenario import BoardScenario, BoardScenarioBases, Scenario, ScenarioBoards
from verify.simulation.session import simulate as session_simulate

CARRY_TIME, N_CARRY_STEPS = 1.2, 3  # s on the way to the next place, and in how many jerks
HOLD_TIME = 2.0  # s
MAX_MOMENTS = 8  # moments: pictures and readings look back a little
DEFAULT_RATE = 10.0  # Hz, where the station file gives none
TRANSFER_TIME = 0.002  # s
PAN_TURN_DEG = 20.0  # either way, where a robot's scenario does not say how the bases turn


@dataclass(frozen=True, slots=True)
class SceneState:
    """How everything stands for a while."""

    number: int  # counts such whiles: pictures of one are alike
    rig_T_board: Array  # (4, 4)
    pan: Array  # (2,), rad, as read
    true_pan: Array  # (2,), rad
    carried: bool


class BoardScene:
    """A board on its way from one place of a scenario to the next, without end.

    Between two places it moves in a few jerks, and all pictures of one moment are alike: to compute
    one takes longer than to look at it. The next moment begins once its pictures are there; on a
    slow machine the board rests a little longer.
    """

    def __init__(self, boards: SimulatedBoards, clock: SimClock) -> None:
        self.boards, self.clock = boards, clock
        self._pool = ThreadPoolExecutor(2, thread_name_prefix="simulated boards")
        self._lock, self._closed = threading.Lock(), False
        # when each began, and which moment
        self._began = deque([(clock.began, N_CARRY_STEPS)], maxlen=MAX_MOMENTS)
        self._pictures: dict[int, tuple[Future[Image], Future[Image]]] = {}
        self._look_ahead()

    def moment(self, t: float) -> SceneState:
        """How everything stands at an instant of the cameras' clock, no later than now."""
        with self._lock:
            self._go_on()
            number = next((n for at, n in reversed(self._began) if at <= t), self._began[0][1])
        return self._moment(number)

    def picture(self, side: int, moment: SceneState) -> Image | None:
        """Take a picture of a moment; None while it is still being computed, or long past."""
        with self._lock:
            pictures = self._pictures.get(moment.number)
        if pictures is None or not wait([pictures[side]], protocols.READ_TIMEOUT).done:
            return None
        return None if pictures[side].cancelled() else pictures[side].result()

    def close(self) -> None:
        """Compute no more."""
        with self._lock:
            self._closed = True
        self._pool.shutdown(wait=False, cancel_futures=True)

    def _moment(self, number: int) -> SceneState:
        place, step = divmod(number, N_CARRY_STEPS + 1)
        here, before = place % len(self.boards), max(place - 1, 0) % len(self.boards)
        share = (step + 1) / (N_CARRY_STEPS + 1)
        boards = self.boards
        return SceneState(
            number,
            _interpolate_pose(boards.rig_T_board[before], boards.rig_T_board[here], share),
            boards.pan[before] + share * (boards.pan[here] - boards.pan[before]),
            boards.true_pan[before] + share * (boards.true_pan[here] - boards.true_pan[before]),
            step < N_CARRY_STEPS,
        )

    def _go_on(self) -> None:
        """Begin the next moment if it is time and its pictures are there."""
        now, (since, number) = self.clock.now(), self._began[-1]
        held = number % (N_CARRY_STEPS + 1) == N_CARRY_STEPS
        lasts = HOLD_TIME if held else CARRY_TIME / N_CARRY_STEPS
        ready = not self._closed and all(p.done() for p in self._pictures[number + 1])
        if ready and now - since >= lasts:
            self._began.append((now, number + 1))
            self._look_ahead()

    def _look_ahead(self) -> None:
        """Have this moment's pictures computed, and the next one's; forget those long past."""
        number = self._began[-1][1]
        for wanted in (number, number + 1):
            if wanted not in self._pictures:
                left, right = (self._pool.submit(self._render, wanted, side) for side in (0, 1))
                self._pictures[wanted] = left, right
        self._pictures = {n: p for n, p in self._pictures.items() if n >= number - 1}

    def _render(self, number: int, side: int) -> Image:
        moment = self._moment(number)
        return self.boards.render(side, number, moment.true_pan, moment.rig_T_board)


class BoardCameras:
    """The simulated station of a calibration.

    A scenario with a robot lends its cameras, as they truly are: boards of the usual kind are
    carried about before them, and the calibration holds for that robot's pictures. `turning`: the
    bases are turned with the board; otherwise they stand.

    Raises:
        InputError: no such scenario, or one that contradicts itself.
    """

    def __init__(self, settings: SimSettings, turning: bool) -> None:
        scenario = library.load(settings.scenario)
        session = None
        if isinstance(scenario, Scenario):
            session = session_simulate.simulate_session(scenario)
            scenario = _board_scenario(session)
        if not turning:
            still = BoardScenarioBases(middle_deg=scenario.bases.middle_deg)
            scenario = msgspec.structs.replace(scenario, bases=still)
        elif not scenario.bases.range_deg:
            found, expected = "has bases that stand still", 'and pan.driver is "sim"'
            raise InputError("bases.range_deg", found, expected, 'Write driver = "fixed".')
        boards = simulate_boards(scenario)
        if session is not None:
            departure = session.true_pan[0] - session.pan[0]
            boards = replace(
                boards, cameras=session.world.bench.cameras, true_pan=boards.true_pan + departure
            )
        self.scene = BoardScene(boards, SimClock(settings.speed))

    @property
    def board(self) -> Board:
        """The board that is carried."""
        return self.scene.boards.board

    def camera(self, side: int, settings: protocols.CameraSettings) -> "SimulatedBoardCamera":
        """Open the left (0) or right (1) camera."""
        return SimulatedBoardCamera(self.scene, side, settings.rate or DEFAULT_RATE)

    def pan(self) -> "SimulatedBoardPan":
        """Open the turning bases."""
        return SimulatedBoardPan(self.scene)


class SimulatedBoardCamera:
    """The left (0) or right (1) camera, at a rate, Hz; both take pictures at the same instants."""

    def __init__(self, scene: BoardScene, side: int, rate: float) -> None:
        self._scene, self._side, self._rate = scene, side, rate
        self._number = self._frames = 0
        self._last: float | None = None  # s, instant of the last picture
        self._closed = False

    def read(self) -> protocols.CameraFrame | None:
        """Give the newest picture; None after READ_TIMEOUT without one."""
        clock = self._scene.clock
        newest = floor((clock.now() - clock.began - TRANSFER_TIME) * self._rate)
        self._number = max(self._number, newest)
        t = clock.began + self._number / self._rate
        if not clock.wait_until(t + TRANSFER_TIME, protocols.READ_TIMEOUT):
            return None
        image = self._scene.picture(self._side, self._scene.moment(t))
        if image is None:
            return None
        self._last = t
        self._number, self._frames = self._number + 1, self._frames + 1
        return protocols.CameraFrame(t, 0.0, image, None, self._frames - 1)

    def state(self) -> protocols.CameraState:
        """Say how the camera is."""
        return protocols.CameraState(
            connected=not self._closed,
            age=None if self._last is None else self._scene.clock.now() - self._last,
            lost=0,
            sentence=f"simulated {SIDES[self._side]} camera: reading",
        )

    def close(self) -> None:
        """Let go of the camera."""
        self._closed = True
        self._scene.close()


class SimulatedBoardPan(SimulatedReadings):
    """Both bases, which are turned while the board is carried."""

    def __init__(self, scene: BoardScene) -> None:
        super().__init__(scene.clock, PAN_RATE)
        self._scene = scene

    def read(self) -> list[protocols.PanReading]:
        """Give what has come since the last call, oldest first; waits for at most 20 ms."""
        moments = [(t, self._scene.moment(t)) for t in self._due()]
        return [
            protocols.PanReading(t, self._came(t), 0.0, 0, moment.pan, moment.carried)
            for t, moment in moments
        ]

    def state(self) -> protocols.DeviceState:
        """Say how the bases are."""
        return self._state("simulated bases: reading")


def _board_scenario(session: session_simulate.SimulatedSession) -> BoardScenario:
    """Carry boards of the usual kind about before the cameras of a session with a robot."""
    scenario = session.scenario
    middle = np.rad2deg(session.pan[0]).tolist()
    return BoardScenario(
        format=1,
        seed=scenario.seed,
        boards=ScenarioBoards(pairs=40),
        bases=BoardScenarioBases(middle_deg=(middle[0], middle[1]), range_deg=PAN_TURN_DEG),
        rig=scenario.rig,
    )


def _interpolate_pose(start: Array, end: Array, share: float) -> Array:
    """A pose (4, 4) on the way from one to another, by shares of turn and of way."""
    turns = Rotation.from_matrix(np.stack([start[:3, :3], end[:3, :3]]))
    place = start[:3, 3] + share * (end[:3, 3] - start[:3, 3])
    return rigid_transform(Slerp([0.0, 1.0], turns)(share).as_matrix(), place)
