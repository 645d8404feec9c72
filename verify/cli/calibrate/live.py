"""`verify calibrate boards STATION --live`: a station's cameras take the pictures."""

from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path

from verify.cli.options import PageOptions
from verify.cli.terminal import STDIN, read_lines, terminal
from verify.cli.watch import show_state, stop_on_signal
from verify.core.fiducials import Board
from verify.errors import InputError
from verify.io import fiducials
from verify.live.boards.pictures import BoardPictures
from verify.live.boards.show import BoardPageSource, BoardSnapshot, BoardState, render_snapshot
from verify.live.boards.take import BoardCapture, BoardDevices
from verify.live.station.cameras import open_station_cameras
from verify.simulation.boards.cameras import BoardCameras

FINISH_KEYS = ("q", "f")
KEYS_HELP = "Enter: take this pair; q and Enter, or Ctrl-C: finish"


def board_of(by_option: Board | None, file: Path | None) -> Board | None:
    """Board of the options or of a board.toml, else None; InputError: both, or no such board."""
    if file is None:
        return by_option
    if by_option is not None:
        found = "is given with --corners"
        raise InputError("--board", found, "only one board is used", "Leave one.")
    board, warnings = fiducials.read_board(file)
    terminal.warn(*warnings)
    return board


def take_pictures(
    station: Path, folder: Path, board: Board | None, enough: int | None, page: PageOptions | None
) -> None:
    """Take pairs of board pictures until there are `enough` or the user finishes.

    Of the station file only cameras and bases are read; `verify calibrate boards` reads the folder.
    Without a board the simulated one is taken.

    Raises:
        InputError: the file, the board, a device or the disk; or no pair was taken.
    """
    opened = open_station_cameras(station, BoardCameras)
    terminal.warn(*opened.warnings)
    board = board or opened.board
    if board is None:
        remedy = "Give --board board.toml of `verify board`, or --corners and --square-mm."
        raise InputError("--board", "is missing", "which board is shown must be known", remedy)
    state = BoardState(BoardSnapshot())
    with ExitStack() as stack:
        devices = BoardDevices(*opened.open_cameras(), opened.open_pan())
        for device in (devices.left, devices.right, devices.pan):
            if device is not None:
                stack.callback(device.close)
        pictures = BoardPictures(folder, board, turning=devices.pan is not None)
        taking = BoardCapture(devices, board, pictures, enough, state)
        if page is not None:
            source = BoardPageSource(state, board, opened.name)
            requests = {"take": taking.ask, "finish": taking.finish}
            stack.callback(page.serve(source, commands=requests).close)
        drawn = show_state(
            lambda: render_snapshot(state.snapshot(), KEYS_HELP), otherwise=_printer(state)
        )
        look = stack.enter_context(drawn)
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
    terminal.record("pictures", folder=str(folder), pairs=len(pictures))


def _printer(state: BoardState) -> Callable[[], None]:
    """Make what prints a line for each pair, and for what is still missing."""
    text = ""

    def look() -> None:
        nonlocal text
        now = state.snapshot()
        if now.last != text:
            text = now.last
            missing = [f"{goal.name}: {goal.words}" for goal in now.goals if not goal.reached]
            terminal.say(f"{text}; " + (f"next, {missing[0]}" if missing else "all is covered"))
            terminal.record("board_pair", pairs=now.pairs, text=text)

    return look


def _read_commands(taking: BoardCapture) -> None:
    def take(line: str) -> None:
        word = line.strip().lower()
        if word in FINISH_KEYS:
            taking.finish()
        elif not word:
            taking.ask()

    read_lines(STDIN, take)
