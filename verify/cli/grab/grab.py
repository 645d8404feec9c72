"""Track a coloured object with both cameras, and pick it up: `verify grab`."""

from pathlib import Path
from typing import Annotated

import typer
from typer import Argument, Option

from verify.cli import options as option
from verify.live.page.access import DEFAULT_PORT, LOOPBACK

EXIT_NOT_GRASPED = 1
DEFAULT_COLOUR = "blue"


def grab(
    station: Annotated[
        Path | None,
        Argument(help="A station file: its cameras, and the MELFA controller it names."),
    ] = None,
    sim: Annotated[
        bool, Option("--sim", help="The simulated cell: caps on a table, arm, cameras.")
    ] = False,
    target: Annotated[
        str | None, Option(help="The object's colour: red, orange, yellow, green, cyan, blue, …")
    ] = None,
    roi: Annotated[
        str | None, Option(help="The object's box in the first left picture: x,y,w,h in pixels.")
    ] = None,
    execute: Annotated[
        bool, Option("--execute", help="Move. Without it the plan is shown and drawn.")
    ] = False,
    auto: Annotated[
        bool, Option("--auto", help="Grab once the object stands still; else on key g.")
    ] = False,
    stop_and_go: Annotated[
        bool, Option("--stop-and-go", help="--sim: one move at a time, as MELFA takes them.")
    ] = False,
    turning: Annotated[
        bool, Option("--turning", help="--sim: the camera bases turn meanwhile.")
    ] = False,
    page: Annotated[
        bool, Option("--page", help="Serve a page: pictures, state, plan; select, grab, stop.")
    ] = False,
    page_port: option.PagePort = DEFAULT_PORT,
    page_address: option.PageAddress = LOOPBACK,
    page_token: option.PageToken = None,
    duration: Annotated[
        float, option.duration_option("Time limit: 60s, 10m.  [default: 60s]", show_default=False)
    ] = 60.0,
    cell: Annotated[
        Path | None, Option(help="Station: the cell's grab.toml; default: beside the station file.")
    ] = None,
    gripper: Annotated[
        str | None, Option(help="Station: the gripper's port; needed with --execute.")
    ] = None,
    seed: Annotated[
        int, Option(min=0, help="--sim: which cell is drawn: where caps stand, the light.")
    ] = 0,
    small: Annotated[
        bool, Option("--small", help="--sim: pictures of 640 x 360 instead of 1280 x 720.")
    ] = False,
    out: Annotated[Path, Option("-o", "--out", help="Where film, session and report go.")] = Path(
        "grab-report"
    ),
    force: option.WriteIntoFolder = False,
) -> int:
    """Track a coloured object, follow it with the arm, pick it up.

    Nothing moves without --execute: the plan is shown and drawn, or why there is none. With it,
    keys, each followed by Enter: g grabs, h holds, r resumes, u opens the fingers and goes up, q
    ends. A station's robot moves only after its name and port were typed;
    emulators need --execute alone.
    With --page and neither --target nor --roi the object is selected on the page.
    None of this replaces the emergency stop, the page's stop button included.

    Exit status 0: lifted, or planned where nothing may move; 1: it ended in another state, which is
    named, or the cameras saw the object left behind; 2: could not run; 130: Ctrl-C ended it before.

    Example: verify grab --sim --execute --auto
    """
    if sim == (station is not None):
        raise typer.BadParameter("give a station file, or --sim for the simulated cell")
    if auto and not execute:
        raise typer.BadParameter("--auto grabs, which --execute has to allow")
    if stop_and_go and not execute:
        raise typer.BadParameter("--stop-and-go moves, which --execute has to allow")
    if target is not None and roi is not None:
        raise typer.BadParameter("give --target or --roi, not both")
    from verify.cli.grab.conduct import GraspOptions

    colour = target if target is not None or roi is not None or page else DEFAULT_COLOUR
    shown = option.PageOptions(page_port, page_address, page_token) if page else None
    options = GraspOptions(colour, roi, execute, auto, duration, shown)
    if station is not None:
        if seed or small or stop_and_go or turning:
            raise typer.BadParameter("--seed, --small, --stop-and-go and --turning are for --sim")
        from verify.cli.grab.station import grab_on_station

        good = grab_on_station(station, cell, gripper, options, out, force=force)
    else:
        if cell is not None or gripper is not None:
            raise typer.BadParameter("--cell and --gripper are for a station")
        from verify.cli.grab.simulated import grab_simulated

        good = grab_simulated(
            options, out, seed=seed, small=small, stop_and_go=stop_and_go, turning=turning,
            force=force,
        )  # fmt: skip
    return 0 if good else EXIT_NOT_GRASPED
