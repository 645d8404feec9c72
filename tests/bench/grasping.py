"""Simulated grasps: successes, false successes, limits, grip error; what correction is worth.

    python -m tests.bench.grasping [N] [--full]
    python -m tests.bench.grasping corrected [N] [--full]

Cells are drawn at random: where the cap stands or slides to, other caps, light, noise, an arm that
is not quite where it was registered. A success is a cap in the hand, as the world knows it; a false
one is a grab that ended in `lifted` without it. Then the paper's experiment: a cap on marks 4 cm
apart, distances measured against actual ones. Corrected: the same drawn cells, grasped with and
without the correction, by an arm as it is stated, and by one with one joint 0.4° off, of which its
encoders and its controller know nothing.
"""

import sys
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from tests.support.grasp.monitor import MonitoredRun, monitored
from verify.core.records import Array
from verify.grasping.actuators.protocols import ExecutePermission
from verify.grasping.control.run import StopConditions, run
from verify.grasping.control.states import GraspState
from verify.grasping.planning.workspace import RESOLUTION
from verify.grasping.tool_offset.offset import OffsetMeasurement
from verify.simulation.cell.grab import CellMode, cell_grab
from verify.simulation.cell.scene import Cap, CellScene, draw_scene
from verify.simulation.cell.setup import FULL_SIZE, SMALL_SIZE, CellSetup, cell_setup

ENDS = StopConditions(duration=40.0, patience=5.0)
ROUNDING = 1e-6  # of a limit
PAIRS = 15  # at each mark: half a second
SPACING = 0.04  # m
FAULT = np.deg2rad(0.4)
JOINTS = 5  # the sixth turns the hand about the approach
OUTSIDE = 5e-4  # m that the arm may leave its box by


@dataclass(frozen=True)
class Grasp:
    run: MonitoredRun
    state: GraspState
    reason: str
    held: bool  # the target is in the hand, as the world knows it
    error: Array  # (3,), m, of the grip point from its goal, base frame; nan: no grip
    works: Array  # s of each cycle

    def keeps_limits(self, outside: float) -> bool:
        """Whether joints kept their limits and the arm left its box by `outside` m at most."""
        watch = self.run.monitor.limits
        return max(watch.speed, watch.acceleration) <= 1 + ROUNDING and watch.outside <= outside


def grasp(setup: CellSetup, scene: CellScene, *, closed: bool = True) -> Grasp:
    mode = CellMode(auto=True, closed=closed)
    cell = monitored(cell_grab(setup, scene, permission=ExecutePermission("bench"), mode=mode))
    works: list[float] = []
    ended = run(cell.loop, cell.source, ENDS, lambda cycle: works.append(cycle.took))
    world, plan = cell.world, cell.loop.aim.plan
    error = np.full(3, np.nan)
    seen = cell.monitor
    if seen.closed_on is not None and seen.closed_at is not None and plan is not None:
        error = seen.closed_on - seen.closed_at - [0.0, 0.0, plan.margin.raised]
    held = world.held is not None and world.held[0] == 0
    return Grasp(cell, ended.state, ended.reason, held, error, np.array(works))


def distances(setup: CellSetup, rows: int = 3, columns: int = 5) -> Array:
    """Measured and actual distance and its standard uncertainty between all marks, (k, 3), m."""
    marks, places, spreads = [], [], []
    for row in range(rows):
        for column in range(columns):
            mark = (0.40 + SPACING * row, SPACING * (column - (columns - 1) / 2))
            made = cell_grab(setup, CellScene((Cap("blue", mark),), seed=row * columns + column))
            for _ in range(PAIRS):
                made.loop.cycle(made.source.pair())
                made.source.wait()
            known = made.loop.aim.target
            marks.append(mark)
            places.append(known.thing.position)
            spreads.append(known.thing.covariance)
    base = np.array([0.3e-3, 0.3e-3, 0.3e-3]) ** 2  # where the robot stands: the same for all
    found = []
    for i, j in combinations(range(len(marks)), 2):
        apart = places[i] - places[j]
        length = float(np.linalg.norm(apart))
        along = apart / length
        spread = spreads[i] + spreads[j] - 2 * np.diag(base)
        actual = float(np.hypot(*(np.array(marks[i]) - marks[j])))
        found.append((length, actual, float(np.sqrt(along @ spread @ along))))
    return np.array(found)


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


def plain(setup: CellSetup, count: int) -> None:
    """Print what becomes of so many cells, and the distances between marks."""
    grasps = []
    for seed in range(count):
        done = grasp(setup, draw_scene(seed))
        grasps.append(done)
        if not done.held or done.state is not GraspState.LIFTED:
            print(f"  seed {seed}: {done.state.value}, {done.reason}; held: {done.held}")
    lifted = [g for g in grasps if g.state is GraspState.LIFTED]
    errors = 1e3 * np.array([g.error for g in grasps if np.isfinite(g.error).all()]).reshape(-1, 3)
    print(f"{count} cells")
    print(f"lifted with the cap in the hand: {sum(g.held for g in lifted)} of {count}")
    print(f"false successes: {sum(not g.held for g in lifted)}")
    over = [seed for seed, g in enumerate(grasps) if not g.keeps_limits(RESOLUTION)]
    print(f"beyond a limit or the box: {over or 'none'}")
    watches = [g.run.monitor.limits for g in grasps]
    speed, hard = max(w.speed for w in watches), max(w.acceleration for w in watches)
    print(f"greatest share of a joint's speed limit {speed:.3f}, of its acceleration {hard:.3f}")
    if len(errors):
        across = np.hypot(errors[:, 0], errors[:, 1])
        rms = np.sqrt(np.mean(across**2))
        print(f"grip error across: rms {rms:.2f} mm, worst {across.max():.2f} mm")
        print(f"grip error along: worst {np.abs(errors[:, 2]).max():.2f} mm")
    works = 1e3 * np.concatenate([g.works for g in grasps])
    output = np.percentile(works, [50, 95, 100])
    print("work a cycle: median {:.1f} ms, 95 % {:.1f} ms, worst {:.1f} ms".format(*output))
    print(f"time to the end: median {np.median([g.run.world.t for g in grasps]):.1f} s")
    found = 1e3 * distances(setup)
    off = found[:, 0] - found[:, 1]
    print(f"distances between marks 40 mm apart: {len(found)}, {found[:, 1].min():.0f} mm to "
          f"{found[:, 1].max():.0f} mm")  # fmt: skip
    print(f"error: rms {np.sqrt(np.mean(off**2)):.2f} mm, worst {np.abs(off).max():.2f} mm; stated "
          f"{np.sqrt(np.mean(found[:, 2] ** 2)):.2f} mm")  # fmt: skip


def corrected(setup: CellSetup, count: int) -> None:
    """Print how far grasps are off with and without the correction."""
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


def main(words: list[str]) -> None:
    """Grasp in cells drawn anew."""
    count = next((int(word) for word in words if word.isdigit()), None)
    size = FULL_SIZE if "--full" in words else SMALL_SIZE
    print(f"pictures of {size[0]} x {size[1]}")
    if "corrected" in words:
        corrected(cell_setup(size), count or 20)
    else:
        plain(cell_setup(size), count or 100)


if __name__ == "__main__":
    main(sys.argv[1:])
