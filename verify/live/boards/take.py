"""Board pictures from live cameras: a pair is taken when the board is still and tells more."""

import threading
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

from verify.calibration.corners.find import find_board
from verify.core.fiducials import Board, BoardPair, BoardView
from verify.core.records import Image, StereoPair
from verify.devices.protocols import CameraDevice, PanDevice
from verify.errors import InputError
from verify.live.boards.goals import CapturedPairs, coverage, goals
from verify.live.boards.pictures import BoardPictures
from verify.live.boards.show import MOVING, READY, REPEATED, SEARCHING, BoardDetection, BoardState
from verify.live.boards.view import MAX_MOTION_PX, StillnessDetector, find_board_coarsely
from verify.live.buffers import PanBuffer
from verify.live.intake import PollingThread, pan_step
from verify.live.pairing import FramePair, Pairing
from verify.live.state import DeviceStatus

READ_TIMEOUT = 0.2  # s for a pair
JOIN_TIMEOUT = 1.0  # s for a thread
SILENCE_TIMEOUT = 1.0  # s without a picture: a camera that is not well
FINISHED = "finished: the calibration goes on in the terminal"
UPSIDE_DOWN = "the board is upside down in one picture: hold it upright"
Views = tuple[BoardView | None, BoardView | None]


@dataclass(frozen=True, slots=True)
class BoardDevices:
    """What a calibration needs of a station."""

    left: CameraDevice
    right: CameraDevice
    pan: PanDevice | None  # None: fixed bases


class LatestPair:
    """The newest pair of pictures: those that came while one was looked at are passed over."""

    def __init__(self) -> None:
        self._pairing = Pairing()
        self._wake = threading.Condition()
        self._pair: FramePair | None = None

    def read(self, camera: CameraDevice, side: int) -> Callable[[], bool]:
        """Make the step that reads the left (0) or right (1) camera, once."""

        def step() -> bool:
            frame = camera.read()
            if frame is None:
                return False
            with self._wake:
                pair = self._pairing.add(side, frame, time.monotonic())
                self._pair = pair or self._pair
                self._wake.notify()
            return True

        return step

    def take(self) -> FramePair | None:
        """Wait a moment for a pair that was not given out yet."""
        with self._wake:
            if self._pair is None:
                self._wake.wait(READ_TIMEOUT)
            pair, self._pair = self._pair, None
            return pair


class BoardCapture:
    """Takes pairs of a board until enough are there or somebody says so.

    Args:
        devices: open ones; whoever opened them closes them.
        board: the pattern.
        pictures: where the pairs go.
        enough: pairs after which it ends by itself; None: it goes on until `finish`.
        state: told everything.
    """

    def __init__(
        self,
        devices: BoardDevices,
        board: Board,
        pictures: BoardPictures,
        enough: int | None,
        state: BoardState,
    ) -> None:
        self._devices, self._board, self._pictures = devices, board, pictures
        self._enough, self._state = enough, state
        self._asked, self._finished = threading.Event(), threading.Event()
        self._latest, self._pans, self._still = LatestPair(), PanBuffer(), StillnessDetector()
        self._taken: CapturedPairs | None = None  # None before the first pair of pictures
        self._looks = 0
        self._troubles: dict[str, str] = {}

    def ask(self) -> None:
        """Take the next pair in which both cameras see the board, still or not."""
        self._asked.set()

    def finish(self) -> None:
        """Take no more."""
        self._finished.set()

    def run(self, look: Callable[[], None] = lambda: None) -> None:
        """Take pairs.

        Args:
            look: called several times a second.

        Raises:
            InputError: the cameras' pictures differ in size, or the disk refuses; the pairs that
                were taken are whole.
        """
        pumps = self._pumps()
        for pump in pumps:
            pump.start()
        try:
            with ThreadPoolExecutor(2, thread_name_prefix="board") as self._pool:
                while not (self._finished.is_set() or self._is_enough() or self._ended()):
                    self._state.change(devices=self._lines())
                    look()
                    pair = self._latest.take()
                    if pair is not None:
                        self._see(pair)
        finally:
            self._state.change(finished=True, status=SEARCHING, words=FINISHED, motion=None)
            for pump in pumps:
                pump.stop()
            for pump in pumps:
                pump.join(JOIN_TIMEOUT)
            look()

    def _pumps(self) -> list[PollingThread]:
        devices = self._devices
        pumps = [
            PollingThread(f"{name} camera", self._latest.read(camera, side), self._failed)
            for side, (name, camera) in enumerate(
                (("left", devices.left), ("right", devices.right))
            )
        ]
        if devices.pan is not None:
            pumps.append(PollingThread("bases", pan_step(devices.pan, self._pans), self._failed))
        return pumps

    def _failed(self, name: str, error: Exception) -> None:
        self._troubles[name] = f"a defect of this program, {type(error).__name__}: {error}"

    def _is_enough(self) -> bool:
        return self._enough is not None and len(self._pictures) >= self._enough

    def _ended(self) -> bool:
        """A file is over: no pair will come."""
        return self._devices.left.state().ended or self._devices.right.state().ended

    def _lines(self) -> tuple[DeviceStatus, ...]:
        lines = []
        for name, camera in (
            ("left camera", self._devices.left),
            ("right camera", self._devices.right),
        ):
            now = camera.state()
            well = now.connected and now.age is not None and now.age < SILENCE_TIMEOUT
            lines.append(DeviceStatus(name, well, self._troubles.get(name, now.sentence)))
        if self._devices.pan is not None:
            pan = self._devices.pan.state()
            well = pan.connected and pan.age is not None and pan.age < SILENCE_TIMEOUT
            lines.append(DeviceStatus("bases", well, self._troubles.get("bases", pan.sentence)))
        return tuple(lines)

    def _see(self, frames: FramePair) -> None:
        """Look at a pair; take it if it is worth it, or asked for."""
        images = (frames.left.image, frames.right.image)
        taken = self._taken_of(images)
        views = self._both(find_board_coarsely, images)
        self._still.add(frames.left.t, *views)
        pan = self._pan(frames.left.t)
        self._looks += 1
        self._state.change(
            look=BoardDetection(self._looks, images, views), motion=self._still.motion
        )
        seen = None if pan is None else BoardPair(len(taken), *pan, *views)
        status, words = self._judged(seen, views, taken)
        self._state.change(
            status=status,
            words=words,
            standings=taken.standings(seen) if seen is not None and None not in views else (),
        )
        asked = self._asked.is_set()
        self._asked.clear()
        if seen is not None and (status == READY or (asked and status != SEARCHING)):
            self._take(frames, seen, taken)
        elif asked:
            self._state.change(last=f"not taken: {words}")

    def _taken_of(self, images: tuple[Image, Image]) -> CapturedPairs:
        """What was taken so far; the first pair tells the pictures' size."""
        (height, width), (high, wide) = (image.shape[:2] for image in images)
        if (height, width) != (high, wide):
            raise InputError(
                "right", f"gives pictures of {wide} x {high} px",
                f"those of the left camera have {width} x {height}",
                "Set one size for both in the station file.",
            )  # fmt: skip
        if self._taken is None or self._taken.image_size != (width, height):
            if self._taken:
                found = f"the pictures have become {width} x {height} px"
                expected = "{} x {} were taken".format(*self._taken.image_size)
                raise InputError("cameras", found, expected, "Set the size in the station file.")
            self._taken = CapturedPairs(self._board, (width, height))
            self._tell_coverage(self._taken)
        return self._taken

    def _both(
        self, find: Callable[[Image, Board], BoardView | None], images: tuple[Image, Image]
    ) -> Views:
        """Search both pictures at once."""
        right = self._pool.submit(find, images[1], self._board)
        return find(images[0], self._board), right.result()

    def _pan(self, t: float) -> tuple[float, float] | None:
        """How the bases stand, rad; None while one turns or nothing tells."""
        return (0.0, 0.0) if self._devices.pan is None else self._pans.at(t)

    def _judged(
        self, seen: BoardPair | None, views: Views, taken: CapturedPairs
    ) -> tuple[str, str]:
        """Say what keeps a pair from being taken by itself."""
        missing = [side for side, v in zip(("left", "right"), views, strict=True) if v is None]
        if missing:
            where = "in either picture" if len(missing) == 2 else f"in the {missing[0]} picture"
            return SEARCHING, f"no board {where}"
        if seen is None:
            return SEARCHING, "a base turns, or does not tell its angle"
        left, right = taken.standings(seen)
        if left.stance.view_T_board[:3, 0] @ right.stance.view_T_board[:3, 0] < 0:
            return SEARCHING, UPSIDE_DOWN
        number = taken.alike(seen)
        if number is not None:
            return REPEATED, f"like pair {number + 1}: move, tilt or turn the board"
        if not self._still.still:
            motion = self._still.motion
            by = "" if motion is None else f": the corners move by {motion:.1f} px"
            return MOVING, f"hold it still{by} ({MAX_MOTION_PX} px are allowed)"
        return READY, "taking it"

    def _take(self, frames: FramePair, seen: BoardPair, taken: CapturedPairs) -> None:
        """Measure the corners as the calibration will, and keep the pair if they are there."""
        images = (frames.left.image, frames.right.image)
        left, right = self._both(find_board, images)
        if left is None or right is None:
            self._state.change(last="not taken: the board is not seen well enough to be measured")
            return
        pair = BoardPair(seen.frame, seen.pan_left, seen.pan_right, left, right)
        times = (frames.left.t, frames.right.t)
        self._pictures.keep(StereoPair(seen.frame, *times, seen.pan_left, seen.pan_right, *images))
        taken.add(pair)
        self._state.change(pairs=len(taken), last=f"pair {len(taken)} taken")
        self._tell_coverage(taken)

    def _tell_coverage(self, taken: CapturedPairs) -> None:
        covered = (coverage(taken, 0), coverage(taken, 1))
        turning = self._devices.pan is not None
        self._state.change(coverage=covered, goals=goals(taken, covered, turning=turning))
