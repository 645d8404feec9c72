"""`verify calibrate boards STATION --live`: the pictures are taken now, by a station's cameras."""

import os
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console

from verify.cli.options import PageOptions
from verify.cli.terminal import terminal
from verify.cli.watch import stop_on_signal
from verify.core.fiducials import Board
from verify.errors import InputError
from verify.io import fiducials
from verify.live.boards.pictures import BoardPictures
from verify.live.boards.show import BoardDisplay, BoardPageSource, BoardState
from verify.live.boards.take import BoardCapture, BoardDevices
from verify.live.page.feed import Page
from verify.live.station.cameras import StationCameras, open_station_cameras
from verify.simulation.boards.cameras import BoardCameras

FOLDER_FORMAT = "boards-%Y-%m-%d-%H%M%S"  # the folder of the pictures, for strftime
FINISH_KEYS = ("q", "f")
KEYS_HELP = "Enter: take this pair; q and Enter, or Ctrl-C: finish"


@dataclass(frozen=True, slots=True)
class BoardRunOptions:
    """How the pictures are wanted."""

    board: Board | None  # None: the simulated one
    pairs: int | None  # after which it ends by itself
    page: PageOptions | None


def pictures_folder(given: Path | None) -> Path:
    """Name the folder of the pictures: as given, or after the time."""
    return given if given is not None else Path(time.strftime(FOLDER_FORMAT))


def board_of(by_option: Board | None, file: Path | None) -> Board | None:
    """Take the board that options or a board.toml tell; None where neither does.

    Raises:
        InputError: both do, or the file is none.
    """
    if file is None:
        return by_option
    if by_option is not None:
        raise InputError("--board", "is given beside --corners", "one board is used", "Leave one.")
    board, warnings = fiducials.read_board(file)
    for warning in warnings:
        terminal.warn(warning)
    return board


def refuse_without_live(source: Path, given: Mapping[str, bool]) -> None:
    """Refuse a station file, and options that mean nothing for pictures that were taken already.

    Raises:
        InputError: names the file, or the first option that was given.
    """
    if source.suffix == ".toml":
        found, expected = "is a station file", "without --live a folder of pictures is expected"
        raise InputError(source, found, expected, "Add --live.")
    for option in (option for option, there in given.items() if there):
        found = "was given with a folder of pictures"
        raise InputError(option, found, "it is for --live", "Leave it out, or add --live.")


def take_pictures(station: Path, folder: Path, wish: BoardRunOptions) -> None:
    """Take pairs of board pictures until enough are there or the user finishes.

    Args:
        station: its file; only cameras and bases are looked at.
        folder: where the pictures go: what `verify calibrate boards` reads.
        wish: how.

    Raises:
        InputError: the file, the board, a device or the disk; or no pair was taken.
    """
    opened = open_station_cameras(station, BoardCameras)
    for warning in opened.warnings:
        terminal.warn(warning)
    board = wish.board or opened.board
    if board is None:
        expected = "which board is shown must be known"
        remedy = (
            "Give --board board.toml, as `verify board` wrote it, or --corners and --square-mm."
        )
        raise InputError("--board", "is missing", expected, remedy)
    state = BoardState()
    with ExitStack() as stack:
        devices = _open_devices(opened, stack)
        pictures = BoardPictures(folder, board, turning=devices.pan is not None)
        taking = BoardCapture(devices, board, pictures, wish.pairs, state)
        if wish.page is not None:
            source = BoardPageSource(state, board, opened.name)
            words = {"take": taking.ask, "finish": taking.finish}
            page = Page(source, wish.page.port, wish.page.address, wish.page.token, words)
            stack.callback(page.close)
            terminal.say(f"page: {page.url}")
            terminal.record({"type": "page", "url": page.url})
        look = stack.enter_context(_show_state(state))
        stop = stack.enter_context(stop_on_signal())
        _read_commands(taking)

        def check() -> None:
            if stop.is_set():
                taking.finish()
            look()

        taking.run(check)
    if not len(pictures):
        remedy = "Try `verify doctor` on the station file, and another place for the board."
        raise InputError(folder, "no pair was taken", "the board in both pictures, still", remedy)
    terminal.say(f"{len(pictures)} pairs in {folder}")
    terminal.record({"type": "pictures", "folder": str(folder), "pairs": len(pictures)})


def _open_devices(station: StationCameras, stack: ExitStack) -> BoardDevices:
    """Open the devices; each is let go with the stack."""
    left, right = station.open_cameras()
    stack.callback(left.close)
    stack.callback(right.close)
    pan = station.open_pan()
    if pan is not None:
        stack.callback(pan.close)
    return BoardDevices(left, right, pan)


@contextmanager
def _show_state(state: BoardState) -> Iterator[Callable[[], None]]:
    """Draw the state where there is a terminal to draw it on; else a line for what changes."""
    if sys.stdout.isatty() and not terminal.as_json and not terminal.quiet:
        with BoardDisplay(Console(), KEYS_HELP) as screen:
            yield lambda: screen.look(state)
        return
    said = ""

    def look() -> None:
        nonlocal said
        now = state.snapshot()
        if now.last != said:
            said = now.last
            missing = [f"{goal.name}: {goal.words}" for goal in now.goals if not goal.reached]
            terminal.say(f"{said}; " + (f"next, {missing[0]}" if missing else "all is covered"))
            terminal.record({"type": "board_pair", "pairs": now.pairs, "text": said})

    yield look


def _read_commands(taking: BoardCapture) -> None:
    """Take what is typed: a line each. An input that ends, or is none, says nothing."""

    def listen() -> None:
        with suppress(OSError, ValueError):  # no input at all
            source = sys.stdin.fileno()
            # not sys.stdin's own lines: a thread that waits in there locks it to the very end
            while typed := os.read(source, 1024):
                for line in typed.decode(errors="replace").splitlines():
                    word = line.strip().lower()
                    if word in FINISH_KEYS:
                        taking.finish()
                    elif not word:
                        taking.ask()

    if sys.stdin is not None:
        threading.Thread(target=listen, name="keys", daemon=True).start()
