"""`verify grab --sim`: the simulated cell as the stage of a grab."""

from datetime import UTC, datetime
from pathlib import Path

from verify import marker_file, rig_file
from verify.commands.grabbing import Stage, Wish, conduct, in_words
from verify.commands.grabbing_page import OnPage
from verify.grab.motion_port import ExecuteRight
from verify.grab.record import Told
from verify.live.pan_book import PanBook
from verify.recording.part import Facts
from verify.results_folder import refuse_existing
from verify.sim.cell import RATE
from verify.sim.cell_grab import cell_grab
from verify.sim.cell_scene import COLOURS, drawn_scene, with_turns
from verify.sim.cell_setup import FULL, ROBOT, SMALL, CellSetup, cell_setup
from verify.warm_up import warm_up


def grab_simulated(
    wish: Wish,
    out: Path,
    *,
    seed: int,
    small: bool,
    stop_and_go: bool,
    turning: bool,
    force: bool,
) -> bool:
    """Grab in the simulated cell; see `conduct`.

    Args:
        wish: what is asked for.
        out: the folder.
        seed: which cell is drawn.
        small: pictures of 640 x 360.
        stop_and_go: the arm takes one move at a time.
        turning: the camera bases turn meanwhile.
        force: write into a folder that exists.

    Raises:
        InputError: an option is no colour, box or duration; the folder cannot be written.
    """
    refuse_existing(out, force=force)
    target, ends = wish.given, wish.ends
    setup = cell_setup(SMALL if small else FULL, turning=turning)
    scene = drawn_scene(seed, wish.colour if wish.colour in COLOURS else "blue")
    scene = with_turns(scene) if turning else scene
    bases = PanBook() if turning else None
    watched = wish.page is not None
    by_key = wish.execute and (watched or not wish.auto)
    right = ExecuteRight("--execute") if wish.execute else None
    paced = watched or by_key
    warm_up()  # compiling while the arm waits would look like stale pictures
    made = cell_grab(
        setup,
        scene,
        target,
        right,
        auto=wish.auto,
        stepped=stop_and_go,
        paced=paced,
        bases=bases,
    )
    told = Told(ROBOT, in_words(target), "simulated", wish.execute, datetime.now(UTC))
    page = None
    if wish.page is not None:
        page = OnPage(wish.page, setup.planner, setup.rig, selects=target is None)
    workspace = setup.planner.workspace
    facts = _facts(setup, turning=turning)
    stage = Stage(made.loop, made.source, workspace, facts, told, RATE, by_key, page)
    return conduct(stage, ends, out, force=force)


def _facts(setup: CellSetup, *, turning: bool) -> Facts:
    return Facts(
        robot=ROBOT,
        joints=len(setup.home),
        files={
            "rig.toml": rig_file.encode(setup.rig),
            "marker.toml": marker_file.encode(setup.marker),
        },
        tables={"description": "a grab in the simulated cell", "clock": {"encoder_offset_s": 0.0}},
        turning=turning,
    )
