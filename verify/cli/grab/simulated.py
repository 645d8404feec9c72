"""`verify grab --sim`: grasp in the simulated cell."""

from datetime import UTC, datetime
from pathlib import Path

from verify.cli.grab.conduct import GraspOptions, GraspRun, conduct, target_name
from verify.grasping.actuators.protocols import ExecutePermission
from verify.grasping.record.record import GraspContext
from verify.io import fiducials, rig
from verify.io.results import refuse_existing
from verify.live.buffers import PanBuffer
from verify.live.recording.session import SessionFacts
from verify.measurement.chain import warm_up
from verify.simulation.cell.cell import RATE
from verify.simulation.cell.grab import CellMode, cell_grab
from verify.simulation.cell.scene import COLOURS, add_pan_turns, draw_scene
from verify.simulation.cell.setup import FULL_SIZE, ROBOT, SMALL_SIZE, cell_setup


def grab_simulated(
    options: GraspOptions,
    out: Path,
    *,
    seed: int,
    small: bool,
    stop_and_go: bool,
    turning: bool,
    force: bool,
) -> bool:
    """Grasp in the simulated cell that `seed` draws; the result is that of `conduct`.

    Raises:
        InputError: an option is no colour, box or duration; the folder cannot be written.
    """
    refuse_existing(out, force=force)
    target, page = options.target, options.page
    setup = cell_setup(SMALL_SIZE if small else FULL_SIZE, turning=turning)
    scene = draw_scene(seed, options.colour if options.colour in COLOURS else "blue")
    scene = add_pan_turns(scene) if turning else scene
    keys = options.execute and (page is not None or not options.auto)
    warm_up()  # loading while the arm waits would look like stale pictures
    cell = cell_grab(
        setup,
        scene,
        target,
        ExecutePermission("--execute") if options.execute else None,
        mode=CellMode(options.auto, stepped=stop_and_go, paced=keys or page is not None),
        bases=PanBuffer() if turning else None,
    )
    name = target_name(target)
    context = GraspContext(ROBOT, name, "simulated", options.execute, datetime.now(UTC))
    facts = SessionFacts(
        robot=ROBOT,
        joints=len(setup.home),
        files={
            "rig.toml": rig.encode(setup.rig),
            "marker.toml": fiducials.encode_marker(setup.marker),
        },
        tables={"description": "a grab in the simulated cell", "clock": {"encoder_offset_s": 0.0}},
        turning=turning,
    )
    stage = GraspRun(
        cell.loop, cell.source, setup.workspace, setup.rig, facts, context, RATE, keys, page
    )
    return conduct(stage, options.stop_conditions, out, force=force)
