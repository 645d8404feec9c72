"""What the LEDs' correction is worth; python -m tests.bench.grasp.closed_loop [N] [--small].

The same drawn cells, grasped with and without it: by an arm as it is stated, and by one with one
joint 0.4° off, of which its encoders and its controller know nothing.
"""

import sys
from dataclasses import replace

import numpy as np

from tests.bench.grasp.open_loop import Grasp, grasp
from verify.grasping.control.states import GraspState
from verify.grasping.tool_offset.offset import OffsetMeasurement
from verify.simulation.cell.scene import draw_scene
from verify.simulation.cell.setup import FULL_SIZE, SMALL_SIZE, CellSetup, cell_setup

FAULT = np.deg2rad(0.4)
JOINTS = 5  # the sixth turns the hand about the approach
OUTSIDE = 5e-4  # m that the arm may leave its box by


def grasp_with_fault(setup: CellSetup, seed: int, fault: float, *, closed: bool) -> Grasp:
    scene = draw_scene(seed)
    if fault:
        errors = np.zeros(6)
        errors[seed % JOINTS] = fault * (1 if seed % 2 else -1)
        scene = replace(scene, joint_errors=tuple(errors.tolist()))
    return grasp(setup, scene, closed=closed)


def correction(done: Grasp) -> OffsetMeasurement | None:
    """The tool offset that the plan used; None: the hand was not measured."""
    planned = done.run.loop.aim.planned
    return None if planned is None else planned.thing.offset


def main() -> None:
    words = sys.argv[1:]
    count = next((int(word) for word in words if word.isdigit()), 20)
    setup = cell_setup(SMALL_SIZE if "--small" in words else FULL_SIZE)
    for name, fault in (("as stated", 0.0), ("one joint 0.4° off", FAULT)):
        pairs = [
            [grasp_with_fault(setup, seed, fault, closed=closed) for closed in (False, True)]
            for seed in range(count)
        ]
        print(f"arm {name}, {count} cells")
        used = []
        for seed, pair in enumerate(pairs):
            offset = correction(pair[1])
            if offset is not None and offset.used:
                used.append(pair)
            else:
                print(f"  seed {seed}: {'not seen' if offset is None else offset.reason}")
        kept = all(closed.keeps_limits(OUTSIDE) for _, closed in pairs)
        print(f"  corrected: {len(used)} of {count}; limits kept: {kept}")
        for what, place in (("without", 0), ("with", 1)):
            errors = 1e3 * np.array([np.linalg.norm(pair[place].error) for pair in used])
            lifted = sum(pair[place].state is GraspState.LIFTED for pair in used)
            print(
                f"  {what}: lifted {lifted}, grip error rms {np.sqrt(np.nanmean(errors**2)):.2f} mm"
                f", worst {np.nanmax(errors):.2f} mm"
            )


if __name__ == "__main__":
    main()
