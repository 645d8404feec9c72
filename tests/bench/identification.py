"""Print what an identified arm is worth: simulated arms, and a real UR10 before a laser tracker.

    python -m tests.bench.identification

Simulated: 50 arms of both kinds (offsets to 2°, lengths to 2 mm, twists to 0.5°), 20 to 500 poses,
noise of 0.02 to 1 mm, stated and not; poses, positions, three points a pose. Printed are the shares
of joint offsets within their U, and the held-out residual over that of the best model. Real: 70 %
of a series identify, 30 % judge (ten splits); and series B by the model of series A.
"""

import time
from collections import defaultdict

import numpy as np

import robots
from tests.support.published import series
from tests.support.true_arm import faulty_arm, recorded
from verify.calibration.kinematics.chain import chain_of
from verify.calibration.kinematics.fit import pose_residuals
from verify.calibration.kinematics.identify import identify_arm, register
from verify.calibration.kinematics.validation import statistics

ARMS = ("iust_6r", "rv_3sd_melfa")
KINDS = ("poses", "positions", "points")
ARMS_DRAWN = 50
LOG_NOISE = np.log([2e-5, 1e-3])  # m


def simulated() -> None:
    """Identify simulated arms; print coverage and held-out residuals."""
    within, ratios, begun = defaultdict(list), [], time.perf_counter()
    for i in range(ARMS_DRAWN):
        draw = np.random.default_rng(10_000 + i)
        truth, kind, stated = faulty_arm(ARMS[i % 2], i), KINDS[i % 3], bool((i // 6) % 2)
        poses, noise = round(np.exp(draw.uniform(*np.log([20, 500])))), draw.uniform(*LOG_NOISE)
        rows = recorded(truth, kind, poses, float(np.exp(noise)), i, stated=stated)
        found = identify_arm(chain_of(truth.arm), rows)
        held = [level.held_out.position[0] for level in found.levels if level.held_out]
        chosen = found.chosen.held_out
        ratios.append(np.inf if chosen is None else chosen.position[0] / min(held))
        fit = found.chosen.fit
        for parameter, change, u in zip(
            fit.parameters, fit.change, fit.standard_uncertainty, strict=True
        ):
            if parameter.kind == "correction":
                error = abs(change - truth.correction[parameter.place])
                for key in (kind, f"noise {'' if stated else 'not '}stated", "all"):
                    within[key].append(error <= fit.coverage_factor * u)
    for key, hits in within.items():
        print(f"offsets within U, {key}: {np.mean(hits):.1%} of {len(hits)}")
    print(f"held out over the best model: {max(ratios):.3f} at most")
    print(f"{ARMS_DRAWN} arms, {time.perf_counter() - begun:.0f} s")


def published() -> None:
    """Identify the UR10 of the shared data."""
    arm, models = chain_of(robots.load("ur10")), {}
    for name in ("A", "B"):
        rows, begun = series(name), time.perf_counter()
        found = identify_arm(arm, rows)
        models[name] = found.chain
        print(f"series {name}: {len(rows)} poses, {time.perf_counter() - begun:.0f} s")
        for level in found.levels:
            held = level.held_out
            print(
                f"  held out, {level.name}: mean, rms, max {(held.position * 1e3).round(3)} mm, "
                f"{np.degrees(held.orientation).round(3)}°, "
                f"{len(level.support.supported)} parameters"
            )
    for name, other in (("A", "B"), ("B", "A")):
        rows = series(other)
        left = statistics(pose_residuals(register(models[name], rows).state, rows)[:, :3]) * 1e3
        print(f"series {other} by the model of {name}: mean, rms, max {left.round(3)} mm")


if __name__ == "__main__":
    simulated()
    published()
