"""Print what an identified arm is worth: simulated arms, and a real UR10 before a laser tracker.

    python -m tests.bench.identification [ARMS]

Simulated: 50 arms of both kinds (offsets to 2°, lengths to 2 mm, twists to 0.5°), 20 to 500 poses,
noise of 0.02 to 1 mm, stated and not; poses, positions, three points a pose. Printed are the shares
of joint offsets and of lengths and twists within their U, the held-out residual over that of the
best model; and how often a scale of 0.5 to 30 % or a slip of 0.3 to 20° is named. Real: 70 %
of a series identify, 30 % judge (ten splits); and series B by the model of series A.
"""

import sys
import tempfile
import time
from collections import Counter, defaultdict
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

import robots
from tests.bench.goals import Figure, Line
from tests.bench.session import command
from tests.support.beside import SHARED
from tests.support.published import series, write_session
from tests.support.true_arm import TrueArm, faulty_arm, recorded
from verify.calibration.kinematics.chain import chain_of
from verify.calibration.kinematics.fit import pose_residuals
from verify.calibration.kinematics.identify import IdentificationOptions, identify_arm, register
from verify.calibration.kinematics.mistakes import refuse_unfit
from verify.calibration.kinematics.poses import IdentificationPoses
from verify.calibration.kinematics.validation import statistics
from verify.core.records import take_rows
from verify.errors import InputError

WHAT = {"correction": "offsets", "alpha": "twists", "beta": "twists"}
MISTAKES = ("none", "scale", "slip")
LOG_SCALE, LOG_SLIP = np.log([0.005, 0.3]), np.log([0.3, 20.0])  # less 1; degrees
ARMS = ("iust_6r", "rv_3sd_melfa")
KINDS = ("poses", "positions", "points")
ARMS_DRAWN = 50
LOG_NOISE = np.log([2e-5, 1e-3])  # m
POSES, MOST_S = 2800, 20.0
ROUNDS = 3


def lines() -> Iterator[Line]:
    """Time `verify identify` on poses of the real UR10, warm."""
    if not (SHARED / "data").is_dir():
        yield f"identification of {POSES} poses: not timed, the published data are not here"
        return
    with tempfile.TemporaryDirectory() as place:
        rows = take_rows(series("A", every=4), np.arange(POSES))
        session = write_session(Path(place) / "ur10", rows)
        free = ("--base", "free", "--leds", "free", "--force", "-o", str(Path(place) / "out"))
        spent = [command("identify", str(session), *free)[0] for _ in range(ROUNDS)]
    yield Figure(f"identify, {POSES} poses", min(spent), "s", most=MOST_S, note=f"best of {ROUNDS}")


def simulated(arms: int) -> None:
    """Identify simulated arms; print coverage and held-out residuals."""
    within, ratios, begun = defaultdict(list), [], time.perf_counter()
    for i in range(arms):
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
            if not parameter.axis:
                error = abs(change - getattr(truth, parameter.kind)[parameter.place])
                of = WHAT.get(parameter.kind, "lengths")
                for key in (kind, f"noise {'' if stated else 'not '}stated", "all"):
                    within[f"{of} within U, {key}"].append(error <= fit.coverage_factor * u)
    for key, hits in sorted(within.items()):
        print(f"{key}: {np.mean(hits):.1%} of {len(hits)}")
    print(f"held out over the best model: {max(ratios):.3f} at most")
    print(f"{arms} arms, {time.perf_counter() - begun:.0f} s")


def refused() -> None:
    """Count sound arms that are refused or warned of, and scales and slips that are named."""
    counts: Counter[tuple[str, str]] = Counter()
    for i in range(ARMS_DRAWN):
        draw = np.random.default_rng(50_000 + i)
        truth, kind, stated = faulty_arm(ARMS[i % 2], i), KINDS[i % 3], bool((i // 6) % 2)
        poses, noise = round(np.exp(draw.uniform(*np.log([20, 500])))), draw.uniform(*LOG_NOISE)
        rows = recorded(truth, kind, poses, float(np.exp(noise)), i, stated=stated)
        rows = take_rows(rows, np.argsort(rows.tool, kind="stable"))
        for mistake in MISTAKES:
            q, joint, sign = rows.q.copy(), int(draw.integers(6)), draw.choice([-1, 1])
            if mistake == "scale":
                q[:, joint] *= 1 + sign * np.exp(draw.uniform(*LOG_SCALE))
            elif mistake == "slip":
                late = rows.block >= draw.uniform(0.15, 0.85) * poses
                q[late, joint] += sign * np.deg2rad(np.exp(draw.uniform(*LOG_SLIP)))
            said = refusal(truth, replace(rows, q=q))
            words = f"joint {joint + 1} {mistake}"
            counts[mistake, "named" if words in said else said.split(":")[0] or "taken"] += 1
    for (mistake, outcome), count in sorted(counts.items()):
        print(f"{mistake}: {outcome} {count}")


def refusal(truth: TrueArm, rows: IdentificationPoses) -> str:
    """What is said of the rows, ordered by target, when they are identified."""
    targets = range(int(rows.tool.max()) + 1)
    sessions = [
        SimpleNamespace(
            session=SimpleNamespace(arm=truth.arm),
            comparison=SimpleNamespace(
                t=rows.block[rows.tool == k] * 10.0, direction=0 * rows.q[rows.tool == k]
            ),
        )
        for k in targets
    ]
    gathered: Any = SimpleNamespace(
        sessions=sessions, source=rows.tool, frame=rows.block, poses=rows
    )
    found = identify_arm(chain_of(truth.arm), rows, IdentificationOptions(splits=2))
    try:
        return "".join(refuse_unfit(Path("encoders.csv"), gathered, found, held=False))
    except InputError as error:
        return f"refused: {error}"


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
    simulated(int(sys.argv[1]) if len(sys.argv) > 1 else ARMS_DRAWN)
    refused()
    published()
