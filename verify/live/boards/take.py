"""Board pictures from live cameras: a pair is taken when the board is still and tells more."""

import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

from verify.calibration.corners.find import find_board
from verify.core.fiducials import Board, BoardPair, BoardView
from verify.core.records import Image, StereoPair
from verify.devices.protocols import CameraDevice, PanDevice
from verify.errors import InputError, defect_text
from verify.live import intake
from verify.live.boards.goals import CapturedPairs, coverage, goals
from verify.live.boards.pictures import BoardPictures
from verify.live.boards.show import MOVING, READY, REPEATED, SEARCHING, BoardDetection, BoardState
from verify.live.boards.view import MAX_MOTION_PX, StillnessDetector, find_board_coarsely
from verify.live.buffers import PanBuffer
from verify.live.pairing import FramePair, Pairing
from verify.live.state import DeviceStatus, device_status, with_troubles

READ_TIMEOUT = 0.2  # s for a pair
JOIN_TIMEOUT = 1.0  # s for a thread
FINISHED = "finished: the calibration continues in the terminal"
UPSIDE_DOWN = "the board is upside down in one picture: hold it upright"
Views = tuple[BoardView | None, BoardView | None]


@dataclass(frozen=True, slots=True)
class BoardDevices:
    """What a calibration needs of a station."""

    left: CameraDevice
    right: CameraDevice
    pan: PanDevice | None  # None: fixed bases


class BoardCapture:
    """Takes pairs of a board until there are `enough` (None: any number), or `finish` is called.

    Whoever opened the devices closes them.
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
        self._requested, self._finished = threading.Event(), threading.Event()
        # pairs that come meanwhile are passed over
        self._latest = intake.PairQueue(Pairing(), size=1)
        self._pans, self._still = PanBuffer(), StillnessDetector()
        self._taken: CapturedPairs | None = None  # None before the first pair of pictures
        self._looks = 0
        self._troubles: dict[str, str] = {}

    def ask(self) -> None:
        """Take the next pair in which both cameras see the board, still or not."""
        self._requested.set()

    def finish(self) -> None:
        """Take no more."""
        self._finished.set()

    def run(self, look: Callable[[], None] = lambda: None) -> None:
        """Take pairs; `look` is called several times a second.

        Raises:
            InputError: the cameras' pictures differ in size, or the disk refuses; the pairs that
                were taken are whole.
        """
        pumps = self._pumps()
        for pump in pumps:
            pump.start()
        try:
            with ThreadPoolExecutor(2, thread_name_prefix="board") as self._pool:
                while not (self._finished.is_set() or self._ended()):
                    self._state.change(devices=self._lines())
                    look()
                    pair = self._latest.take(READ_TIMEOUT)
                    if pair is not None:
                        self._see(pair)
        finally:
            self._state.change(finished=True, status=SEARCHING, words=FINISHED, motion=None)
            intake.stop_threads(pumps, JOIN_TIMEOUT)
            look()

    def _pumps(self) -> list[intake.PollingThread]:
        devices, latest = self._devices, self._latest
        steps = [
            ("left camera", intake.camera_step(devices.left, 0, latest, patient=False)),
            ("right camera", intake.camera_step(devices.right, 1, latest, patient=False)),
        ]
        if devices.pan is not None:
            steps.append(("bases", intake.readings_step(devices.pan, self._pans.add)))
        return [intake.PollingThread(name, step, self._failed) for name, step in steps]

    def _failed(self, name: str, error: Exception) -> None:
        self._troubles[name] = defect_text(error)

    def _ended(self) -> bool:
        """Enough is taken, or a file is over: no pair will come."""
        enough = self._enough is not None and len(self._pictures) >= self._enough
        return enough or self._devices.left.state().ended or self._devices.right.state().ended

    def _lines(self) -> tuple[DeviceStatus, ...]:
        devices = self._devices
        named = {"left camera": devices.left, "right camera": devices.right, "bases": devices.pan}
        lines = (device_status(n, d.state()) for n, d in named.items() if d is not None)
        return with_troubles(lines, self._troubles)

    def _see(self, frames: FramePair) -> None:
        """Look at a pair; take it if it adds information, or was requested."""
        images = (frames.left.image, frames.right.image)
        taken = self._taken_of(images)
        views = self._both(find_board_coarsely, images)
        self._still.add(frames.left.t, *views)
        # angles of the bases, rad; None while one turns or there is no reading
        pan = (0.0, 0.0) if self._devices.pan is None else self._pans.at(frames.left.t)
        self._looks += 1
        self._state.change(
            look=BoardDetection(self._looks, images, views), motion=self._still.motion
        )
        boards = None if pan is None else BoardPair(len(taken), *pan, *views)
        status, words = self._judged(boards, views, taken)
        self._state.change(
            status=status,
            words=words,
            placements=taken.placements(boards) if boards is not None and None not in views else (),
        )
        requested = self._requested.is_set()
        self._requested.clear()
        if boards is not None and (status == READY or (requested and status != SEARCHING)):
            self._take(frames, boards, taken)
        elif requested:
            self._state.change(last=f"not taken: {words}")

    def _taken_of(self, images: tuple[Image, Image]) -> CapturedPairs:
        """The pairs taken so far; the first pair sets the pictures' size."""
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
            self._update_coverage(self._taken)
        return self._taken

    def _both(
        self, find: Callable[[Image, Board], BoardView | None], images: tuple[Image, Image]
    ) -> Views:
        """Search both pictures at once."""
        right = self._pool.submit(find, images[1], self._board)
        return find(images[0], self._board), right.result()

    def _judged(
        self, boards: BoardPair | None, views: Views, taken: CapturedPairs
    ) -> tuple[str, str]:
        """Status of a pair, and why it is not taken by itself."""
        missing = [side for side, v in zip(("left", "right"), views, strict=True) if v is None]
        if missing:
            where = "in either picture" if len(missing) == 2 else f"in the {missing[0]} picture"
            return SEARCHING, f"no board {where}"
        if boards is None:
            return SEARCHING, "a base turns, or does not tell its angle"
        left, right = taken.placements(boards)
        if left.orientation.view_T_board[:3, 0] @ right.orientation.view_T_board[:3, 0] < 0:
            return SEARCHING, UPSIDE_DOWN
        number = taken.alike(boards)
        if number is not None:
            return REPEATED, f"like pair {number + 1}: move, tilt or turn the board"
        if not self._still.still:
            motion = self._still.motion
            by = "" if motion is None else f": the corners move by {motion:.1f} px"
            return MOVING, f"hold it still{by} ({MAX_MOTION_PX} px are allowed)"
        return READY, "taking it"

    def _take(self, frames: FramePair, boards: BoardPair, taken: CapturedPairs) -> None:
        """Measure the corners as the calibration will, and keep the pair if they are there."""
        images = (frames.left.image, frames.right.image)
        left, right = self._both(find_board, images)
        if left is None or right is None:
            self._state.change(last="not taken: the board is not seen well enough to be measured")
            return
        times, pans = (frames.left.t, frames.right.t), (boards.pan_left, boards.pan_right)
        self._pictures.keep(StereoPair(boards.frame, *times, *pans, *images))
        taken.add(BoardPair(boards.frame, *pans, left, right))
        self._state.change(pairs=len(taken), last=f"pair {len(taken)} taken")
        self._update_coverage(taken)

    def _update_coverage(self, taken: CapturedPairs) -> None:
        covered = (coverage(taken, 0), coverage(taken, 1))
        turning = self._devices.pan is not None
        self._state.change(coverage=covered, goals=goals(taken, covered, turning=turning))
