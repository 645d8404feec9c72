"""Refuse readings that no base and target make this arm's motion, and name what explains them.

Before the fit, usual mistakes: base and target are free, so poses and readings cannot be laid side
by side, and each mistake is judged by what a registration leaves of a few poses. After it, where
much is left of poses held out:

    readings = angles + offset + f x        f (n, j): the angles, or 1 from some pose on

fitted with base and target free tells a held base that is elsewhere (x = 0), scaled readings, and
belts that slipped. Each is named where it leaves less than a MIN_FACTOR-th of what is left without.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np

from verify.analysis.least_squares import gauss_newton
from verify.analysis.mistakes import LEVER, joint_mistakes
from verify.analysis.plausibility import usual_mistakes
from verify.calibration.kinematics.chain import (
    ANGLE_UNIT,
    ArmState,
    chain_of,
    change_state,
    offset_parameters,
    registration_parameters,
)
from verify.calibration.kinematics.fit import pose_residuals, scaled_columns, tolerances
from verify.calibration.kinematics.model import start_state
from verify.calibration.kinematics.poses import IdentificationPoses, select_rows
from verify.calibration.kinematics.sessions import CombinedPoses
from verify.calibration.kinematics.validation import CrossValidation
from verify.core.readings import Readings
from verify.core.records import Array
from verify.errors import InputError

MIN_LEFT = 0.02  # m, mean: an arm of 1 m with 2° in a joint leaves about as much
DOUBTFUL = 0.005  # m: so much is left that an explanation is sought
MIN_FACTOR = 3.0  # of what is left as written over what a mistake leaves
MAX_ROWS = 80  # that are registered for each mistake
MIN_SIDE = 6  # poses on either side of a change
MAX_CHANGES = 12  # of an offset that are tried
MIN_SHARE = 0.2  # of the largest fault: a smaller one beside it is not named
MAX_ITERATIONS = 20
TOL_STEP = 1e-4  # of 1 mm or 1°
RIDGE = 1e-9  # of the greatest information: what a motion leaves open stays as it is


def refuse_mistaken_readings(file: Path, gathered: CombinedPoses) -> None:
    """Refuse readings, or poses, that fit far better once a usual mistake is taken back.

    Poses of several bases or targets are not judged: a registration of one would leave them all.

    Raises:
        InputError: names the mistake and what remains without it.
    """
    first, rows = gathered.sessions[0].session, _few(gathered)
    if len(np.unique(rows.base)) > 1 or len(np.unique(rows.tool)) > 1:
        return
    written = _left(start_state(chain_of(first.arm), rows), rows)
    if written < MIN_LEFT:
        return
    readings = Readings(np.arange(len(rows), dtype=float), rows.q)
    posed = first.instrument is not None
    of_poses = usual_mistakes(rows.world_T_target, alone=rows.position_only) if posed else ()
    tried: list[tuple[Path, str, str, IdentificationPoses]] = [
        (file, name, do, replace(rows, q=without.q))
        for name, do, without in joint_mistakes(readings)
    ]
    place = first.left.path
    tried += [(place, name, do, replace(rows, world_T_target=it)) for name, do, it in of_poses]
    left = [_left(start_state(chain_of(first.arm), one[-1]), one[-1]) for one in tried]
    place, name, remedy, _ = tried[best := int(np.argmin(left))]
    if left[best] * MIN_FACTOR < written:
        found = f"{_mm(written)} of the poses, wherever base and target are"
        raise _refusal(place, f"{found}; {name} fits: {_mm(left[best])}", remedy)


def refuse_unfit(
    file: Path, gathered: CombinedPoses, left: CrossValidation | None, *, held: bool
) -> None:
    """Refuse readings that nothing which was identified makes this arm's motion.

    `left`: what the chosen model leaves of poses that it was not fitted to; None where no poses
    were held out, and nothing is refused. `held`: base or target were not free.

    Raises:
        InputError: more is left of poses held out than any arm's own errors leave, or a base, a
            scale or a slip explains most of it.
    """
    if left is None:
        return
    size = float(left.position[0] + LEVER * np.nan_to_num(left.orientation[0]))
    rows, found = _few(gathered), f"{_mm(size)} of poses held out"
    if size > DOUBTFUL and len(rows) >= 2 * MIN_SIDE:
        start = start_state(chain_of(gathered.sessions[0].session.arm), rows)
        _, free = _fit(start, rows, np.zeros_like(rows.q))
        stated = _length(rows.nuisance.reshape(len(rows), 2, -1), rows)
        if held and max(free, stated) * MIN_FACTOR < size:
            found += f", base and target held; another base and target fit: {_mm(free)}"
            raise _refusal(file, found, "Register again, or free both: --base free --leds free.")
        name, least = _scale_or_slip(start, rows, gathered)
        if least * MIN_FACTOR < free:
            remedy = "Undo the scale, or identify from the poses on one side of the slip."
            raise _refusal(file, f"{found}; {name} fits: {_mm(least)}", remedy)
    if size > MIN_LEFT:
        check = "Check units, signs and order in both files, and each mistake by itself."
        raise _refusal(file, f"{found}; no single mistake, scale or slip explains it", check)


def _scale_or_slip(
    start: ArmState, rows: IdentificationPoses, gathered: CombinedPoses
) -> tuple[str, float]:
    """The scaled readings, or belts that slipped, that explain the rows best; what they leave, m.

    Slips are sought in a single recording, at a few places.
    """
    n, single = len(rows), len(gathered.sessions) == 1
    fits = [(*_fit(start, rows, rows.q), 0)]
    for at in np.linspace(MIN_SIDE, n - MIN_SIDE, MAX_CHANGES).astype(int).tolist() * single:
        late = np.arange(n)[:, None] >= at
        before = start_state(start.chain, select_rows(rows, ~late[:, 0]))
        fits.append((*_fit(before, rows, np.repeat(late * 1.0, start.chain.dof, axis=1)), at))
    x, least, at = min(fits, key=lambda fit: fit[1])
    pose = int(np.linspace(0, len(gathered.frame) - 1, n)[at]) + 1
    what = [
        f"joint {j + 1} "
        + (
            f"slipped by {np.rad2deg(x[j]):+.2g}° at about pose {pose}"
            if at
            else f"scaled by {1 / (1 - x[j]):.3g}"
        )
        for j in np.flatnonzero(np.abs(x) > MIN_SHARE * np.abs(x).max()).tolist()
    ]
    return " and ".join(what), least


def _few(gathered: CombinedPoses) -> IdentificationPoses:
    """Some rows, an instrument's as its file has them."""
    rows = gathered.poses
    targets = rows.world_T_target.copy()
    for i, one in enumerate(gathered.sessions):
        if (instrument := one.session.instrument) is not None:
            targets[gathered.source == i] = instrument.poses.transforms[one.frame]
    some = np.zeros(len(rows), dtype=bool)
    some[np.unique(np.linspace(0, len(rows) - 1, MAX_ROWS).astype(int))] = True
    return select_rows(replace(rows, world_T_target=targets), some)


def _fit(start: ArmState, rows: IdentificationPoses, factor: Array) -> tuple[Array, float]:
    """Fit base, target, offsets and x; x (j,), rad a unit of `factor` (n, j), and what is left."""
    alone, dof = rows.position_only, start.chain.dof
    parameters = (
        *registration_parameters("base", len(start.base), position_only=alone),
        *registration_parameters("tool", len(start.tool), position_only=alone),
        *offset_parameters(start.chain),
    )
    weight = np.repeat([1.0, LEVER if (rows.dimensions == 6).all() else 0.0], 3)

    def without(x: Array) -> IdentificationPoses:
        return replace(rows, q=rows.q - factor * x)

    def solve_step(at: tuple[ArmState, Array]) -> tuple[Array, None]:
        left, columns = scaled_columns(at[0], without(at[1]), parameters)
        columns = np.concatenate([columns, -columns[:, :, -dof:] * factor[:, None]], axis=2)
        design = (columns * weight[:, None]).reshape(6 * len(rows), -1)
        normal = design.T @ design
        damped = normal + RIDGE * np.diag(normal).max() * np.eye(len(normal))
        return np.linalg.solve(damped, design.T @ (left * weight).reshape(-1)), None

    def move(at: tuple[ArmState, Array], step: Array) -> tuple[ArmState, Array]:
        change = step[:-dof] * tolerances(parameters)
        return change_state(at[0], parameters, change), at[1] + step[-dof:] * ANGLE_UNIT

    begun = (start, np.zeros(dof))
    (state, x), _ = gauss_newton(
        begun, solve_step, move, max_iterations=MAX_ITERATIONS, tol_step=TOL_STEP
    )
    return x, _left(state, without(x))


def _left(state: ArmState, rows: IdentificationPoses) -> float:
    """Mean length that is left of the poses, m: of positions, and of turns at LEVER."""
    return _length(pose_residuals(state, rows).reshape(-1, 2, 3), rows)


def _length(parts: Array, rows: IdentificationPoses) -> float:
    """Mean length, m, of what moves places and turns, (n, 2, .); of these if measured in full."""
    lever = LEVER if (rows.dimensions == 6).all() else 0.0
    return float((np.linalg.norm(parts, axis=2) @ [1.0, lever]).mean())


def _refusal(file: Path, found: str, remedy: str) -> InputError:
    expected = "readings in the robot file's sense, zero and order"
    return InputError(file, f"the readings are not this arm's motion: {found}", expected, remedy)


def _mm(size: float) -> str:
    return f"{size * 1e3:.3g} mm are left"
