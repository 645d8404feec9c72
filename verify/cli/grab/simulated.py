"""`verify grab --sim`: the simulated cell as the stage of a grab."""

from datetime import UTC, datetime
from pathlib import Path

from verify.analysis.warm_up import warm_up
from verify.cli.grab.conduct import GraspOptions, GraspRun, PageContext, conduct, target_name
from verify.grasping.actuators.protocols import ExecutePermission
from verify.grasping.record.record import GraspContext
from verify.io import fiducials, rig
from verify.io.results import refuse_existing
from verify.live.buffers import PanBuffer
from verify.live.recording.session import SessionFacts
from verify.simulation.cell.cell import RATE
from verify.simulation.cell.grab import CellMode, cell_grab
from verify.simulation.cell.scene import COLOURS, add_pan_turns, draw_scene
from verify.simulation.cell.setup import FULL_SIZE, ROBOT, SMALL_SIZE, CellSetup, cell_setup


def grab_simulated(
    wish: GraspOptions,
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
    setup = cell_setup(SMALL_SIZE if small else FULL_SIZE, turning=turning)
    scene = draw_scene(seed, wish.colour if wish.colour in COLOURS else "blue")
    scene = add_pan_turns(scene) if turning else scene
    bases = PanBuffer() if turning else None
    watched = wish.page is not None
    by_key = wish.execute and (watched or not wish.auto)
    right = ExecutePermission("--execute") if wish.execute else None
    paced = watched or by_key
    warm_up()  # compiling while the arm waits would look like stale pictures
    made = cell_grab(
        setup,
        scene,
        target,
        right,
        mode=CellMode(auto=wish.auto, stepped=stop_and_go, paced=paced),
        bases=bases,
    )
    told = GraspContext(ROBOT, target_name(target), "simulated", wish.execute, datetime.now(UTC))
    page = None
    if wish.page is not None:
        page = PageContext(wish.page, setup.planner, setup.rig, selects=target is None)
    workspace = setup.planner.workspace
    facts = _facts(setup, turning=turning)
    stage = GraspRun(made.loop, made.source, workspace, facts, told, RATE, by_key, page)
    return conduct(stage, ends, out, force=force)


def _facts(setup: CellSetup, *, turning: bool) -> SessionFacts:
    return SessionFacts(
        robot=ROBOT,
        joints=len(setup.home),
        files={
            "rig.toml": rig.encode(setup.rig),
            "marker.toml": fiducials.encode_marker(setup.marker),
        },
        tables={"description": "a grab in the simulated cell", "clock": {"encoder_offset_s": 0.0}},
        turning=turning,
    )
