"""What the LEDs' correction is worth; python -m tests.bench.grasp.closed_loop [N] [--small].

The same drawn cells, grasped with and without it: by an arm as it is stated, and by one with one
joint 0.4° off, of which its encoders and its controller know nothing.
"""

import sys
from dataclasses import dataclass, replace

import numpy as np

from verify.grasping.actuators.protocols import ExecutePermission
from verify.grasping.control.run import StopConditions, run
from verify.simulation.cell.grab import CellMode, cell_grab
from verify.simulation.cell.scene import draw_scene
from verify.simulation.cell.setup import FULL_SIZE, SMALL_SIZE, CellSetup, cell_setup

ENDS = StopConditions(duration=40.0, patience=5.0)
FAULT = np.deg2rad(0.4)
JOINTS = 5  # the sixth turns the hand about the approach
ROUNDING = 1e-6  # of a limit


@dataclass(frozen=True)
class Grasp:
    error: float  # m, of the grip point; nan: no grip
    state: str
    used: bool
    said: str
    kept: bool  # all limits


def grasp(setup: CellSetup, seed: int, fault: float, *, closed: bool) -> Grasp:
    scene = draw_scene(seed)
    if fault:
        errors = np.zeros(6)
        errors[seed % JOINTS] = fault * (1 if seed % 2 else -1)
        scene = replace(scene, joint_errors=tuple(errors.tolist()))
    made = cell_grab(
        setup, scene, right=ExecutePermission("bench"), mode=CellMode(auto=True, closed=closed)
    )
    ended = run(made.loop, made.source, ENDS, lambda _: None)
    world, planned = made.world, made.loop.aim.planned
    plan, seen = made.loop.aim.plan, None if planned is None else planned.thing.offset
    error = np.nan
    if world.closed_on is not None and world.closed_at is not None and plan is not None:
        off = world.closed_on - world.closed_at - [0.0, 0.0, plan.margin.raised]
        error = float(np.linalg.norm(off))
    watch = world.watch
    kept = max(watch.speed, watch.acceleration) < 1 + ROUNDING and watch.outside < 5e-4
    said = "not seen" if seen is None else seen.reason
    return Grasp(error, ended.state.value, seen is not None and seen.used, said, kept)


def main() -> None:
    words = sys.argv[1:]
    count = next((int(word) for word in words if word.isdigit()), 20)
    setup = cell_setup(SMALL_SIZE if "--small" in words else FULL_SIZE)
    for name, fault in (("as stated", 0.0), ("one joint 0.4° off", FAULT)):
        pairs = [[grasp(setup, s, fault, closed=c) for c in (False, True)] for s in range(count)]
        print(f"arm {name}, {count} cells")
        for seed, (_, closed) in enumerate(pairs):
            if not closed.used:
                print(f"  seed {seed}: {closed.said}")
        used = [pair for pair in pairs if pair[1].used]
        print(f"  corrected: {len(used)} of {count}; limits kept: {all(c.kept for _, c in pairs)}")
        for what, place in (("without", 0), ("with", 1)):
            errors = 1e3 * np.array([pair[place].error for pair in used])
            lifted = sum(pair[place].state == "lifted" for pair in used)
            print(
                f"  {what}: lifted {lifted}, grip error rms {np.sqrt(np.nanmean(errors**2)):.2f} mm"
                f", worst {np.nanmax(errors):.2f} mm"
            )


if __name__ == "__main__":
    main()
