"""Print what an identified arm is worth: a real UR10 before a laser tracker, all poses.

    python -m tests.bench.identification

Registered alone, identified on 70 % and judged on the other 30 % (ten splits), and series B by the
model of series A.
"""

import time

import numpy as np

import robots
from tests.support.published import series
from verify.calibration.kinematics.chain import chain_of
from verify.calibration.kinematics.fit import pose_residuals, statistics
from verify.calibration.kinematics.identify import identify_arm, register

if __name__ == "__main__":
    arm = chain_of(robots.load("ur10"))
    models = {}
    for name in ("A", "B"):
        rows, begun = series(name), time.perf_counter()
        found = identify_arm(arm, rows)
        models[name] = found.chain
        print(f"series {name}: {len(rows)} poses, {time.perf_counter() - begun:.0f} s")
        registered = found.level("registration").fit.state
        left = statistics(pose_residuals(registered, rows)[:, :3]) * 1e3
        print(f"  base and tool alone, all poses: mean, rms, max {left.round(3)} mm")
        for level in found.levels:
            held = level.held_out
            assert held is not None
            print(
                f"  held out, {level.name}: mean, rms, max {(held.position * 1e3).round(3)} mm, "
                f"{np.degrees(held.orientation).round(3)}°, "
                f"{len(level.fit.parameters)} parameters of rank {level.support.rank}"
            )
    for name, other in (("A", "B"), ("B", "A")):
        rows = series(other)
        left = statistics(pose_residuals(register(models[name], rows).state, rows)[:, :3]) * 1e3
        print(f"series {other} by the model of {name}: mean, rms, max {left.round(3)} mm")
