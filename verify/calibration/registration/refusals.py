"""Refuse motions that leave base or LEDs open, and readings of another robot.

With the DH table held, what a motion leaves open is a motion of the base that an opposite one of
the LED body makes up for: a turn about, or a shift along, the only axis that turned.
"""

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
from scipy.optimize import minimize_scalar

import robots
from robots.transforms import rigid_columns
from verify.analysis.diagnosis.faults import MAX_OFFSET
from verify.analysis.mistakes import LEVER, joint_mistakes
from verify.analysis.other_motion import MAX_FROZEN, MAX_LEFT_SHARE
from verify.calibration.registration.adjustment import AdjustedRegistration
from verify.calibration.registration.start import RegistrationStart
from verify.calibration.stereo.records import rms
from verify.core.readings import Readings
from verify.core.records import Array
from verify.errors import InputError

MAX_UNCERTAINTY = (5e-3, np.deg2rad(0.5))  # m, rad: known worse, base and LEDs count as open
SWING_ANGLE = np.deg2rad(20.0)  # a movement that would be added, either way
SWING_PAIRS = 5.0  # pairs at each end of it
MIN_PARALLEL_COSINE = 0.999  # cosine between directions that are called one
# of an undetermined direction, in units of the limits: it is a turn, not a shift
MIN_TURN_SHARE = 0.2
MAX_TURN_DIFFERENCE = np.deg2rad(5.0)  # median; a degree of joint error makes one
Restart = Callable[[Readings], RegistrationStart]
MAX_REFUSED_SHARE = 0.5  # of the spots: with more, neither rig nor readings fit
TOL_ZERO = np.deg2rad(0.02)
MAX_MISFIT = 5.0  # times the noise, above which a mistake in the readings is sought
MAX_RMS_PX = 10.0  # a degree of joint error makes a few; these are another robot's readings


def refuse_undetermined(arm: robots.Arm, q: Array, noise: tuple[float, float], place: str) -> None:
    """Refuse a motion q (n, j), rad, that leaves the base and the LEDs open against each other.

    The noise, m and rad, is the standard uncertainty of the body's pose in one pair, readings
    included.

    Raises:
        InputError: names what is undetermined and the movement to add.
    """
    information = _information(arm, q, noise)
    open_ones = _open_directions(information)
    if not open_ones.shape[1]:
        return
    more = " and ".join(f"joint {j + 1}" for j in _joints_to_move(arm, q, noise, information))
    raise InputError(
        place,
        f"the motion leaves {_open_motions_text(arm, q, open_ones)} undetermined, as the LEDs on "
        "the flange could make up for it",
        "base and LEDs together need turns about two axes that are not parallel",
        f"Add a movement of {more} by {np.rad2deg(SWING_ANGLE):.0f}° or more either way.",
    )


def _information(arm: robots.Arm, q: Array, noise: tuple[float, float]) -> Array:
    """Information on base (base axes) and body (flange axes) by poses at q, (12, 12).

    In units of MAX_UNCERTAINTY: directions of eigenvalues below 1 are open.
    """
    flange = robots.forward(arm, q)
    columns = np.zeros((len(q), 6, 12))
    columns[:, :3, :6] = rigid_columns(flange[:, :3, 3])
    columns[:, 3:, 3:6] = np.eye(3)
    columns[:, :3, 6:9] = columns[:, 3:, 9:] = flange[:, :3, :3]
    rows = columns / np.repeat(noise, 3)[:, None] * np.tile(np.repeat(MAX_UNCERTAINTY, 3), 2)
    return np.asarray(np.einsum("nij,nik->jk", rows, rows))


def _open_directions(information: Array) -> Array:
    """Directions known worse than the limits, (12, k), in units of them."""
    values, vectors = np.linalg.eigh(information)
    return np.asarray(vectors[:, values < 1.0], dtype=np.float64)


def _joints_to_move(
    arm: robots.Arm, q: Array, noise: tuple[float, float], information: Array
) -> list[int]:
    """Joints whose movement about the mean posture would determine everything, fewest first."""
    middle = q.mean(axis=0)
    added: list[int] = []
    while _open_directions(information).shape[1] and len(added) < arm.dof:
        options = []
        for j in sorted(set(range(arm.dof)) - set(added)):
            ends = np.stack([middle, middle])
            ends[:, j] += [-SWING_ANGLE, SWING_ANGLE]
            ends = np.clip(ends, arm.lower, arm.upper)
            more = information + SWING_PAIRS * _information(arm, ends, noise)
            least = np.linalg.eigvalsh(more)
            options.append((int((least < 1.0).sum()), -float(least[0]), j, more))
        _, _, best, information = min(options, key=lambda o: o[:3])
        added.append(best)
    return added


def _open_motions_text(arm: robots.Arm, q: Array, open_ones: Array) -> str:
    """Describe which motions of the base are open."""
    base = open_ones[:6]
    turning, size, mixing = np.linalg.svd(base[3:], full_matrices=True)
    turns = [turning[:, k] for k in range(len(size)) if size[k] > MIN_TURN_SHARE]
    still = mixing[len(turns) :].T  # combinations that do not turn
    shifting, length, _ = np.linalg.svd(base[:3] @ still, full_matrices=True)
    shifts = [shifting[:, k] for k in range(len(length)) if length[k] > MIN_TURN_SHARE]
    words = [f"the base's position along {_axis(arm, q, d)}" for d in shifts]
    if len(shifts) == 3:
        words = ["the base's position"]
    about = [f"its turn about {_axis(arm, q, d)}" for d in turns]
    words += ["its orientation"] if len(turns) == 3 else about
    return " and ".join(words) or "base and LEDs"


def _axis(arm: robots.Arm, q: Array, direction: Array) -> str:
    """Name a direction in base axes by the joint that turned about it."""
    axes = robots.jacobian(arm, q.mean(axis=0))[3:]
    travel = np.ptp(q, axis=0)
    for j in np.argsort(-travel).tolist():
        if travel[j] > 0 and abs(float(axes[:, j] @ direction)) > MIN_PARALLEL_COSINE:
            return f"joint {j + 1}'s axis"
    x, y, z = direction * np.sign(direction[np.argmax(np.abs(direction))])
    return f"({x:.2f}, {y:.2f}, {z:.2f}) in the robot's base"


def refuse_other_robot(
    start: RegistrationStart, folder: Path, robot: str, readings: Readings, restart: Restart
) -> None:
    """Refuse readings by which the flange turns otherwise than its LEDs, or mirrored.

    The start is in closed form with neither base nor LEDs held; `restart` gives it with other
    readings.

    Raises:
        InputError: the turns of readings and pictures differ by more than joint errors explain, or
            agree only with those of a mirror image.
    """
    # median angle by which flange and LEDs turn otherwise
    off = float(np.median(np.linalg.norm(start.solved.residual[start.good, 3:], axis=1)))
    check = (
        f'that "{robot}" is the robot that moved, and the order, signs and unit (degrees) of the '
        "columns in encoders.csv"
    )
    found = (
        f"by its readings the flange turns differently from its LEDs, {np.rad2deg(off):.0f}° off"
    )
    expected = f"{np.rad2deg(MAX_TURN_DIFFERENCE):.0f}° are the worst that joint errors explain"
    if off > MAX_TURN_DIFFERENCE:
        name, remedy = _name_mistake(start, readings, restart) or ("", f"Check {check}.")
        raise InputError(folder / "encoders.csv", f"{found} (median){name}", expected, remedy)
    if start.solved.mirrored:
        raise InputError(
            folder / "encoders.csv",
            "what moves together moves like a mirror image of what the readings say",
            "the LEDs themselves must be seen, and the readings be this robot's",
            f"Check {check}; or cover the shiny surface that shows the LEDs.",
        )


def _difference(start: RegistrationStart) -> float:
    """Median of the angle by which flange and LEDs move otherwise, and the distance over LEVER."""
    parts = start.solved.residual[start.good].reshape(-1, 2, 3)
    return float(np.median(np.linalg.norm(parts, axis=2) @ [1 / LEVER, 1.0]))


def _name_mistake(
    start: RegistrationStart, readings: Readings, restart: Restart
) -> tuple[str, str] | None:
    """The mistake without which flange and LEDs move alike, and its remedy.

    Either what is kept, or a usual one in the readings.
    """
    fitted = _difference(restart(readings))
    if fitted <= MAX_LEFT_SHARE * _difference(start):
        found = f"; base and LEDs elsewhere than those kept fit: {np.rad2deg(fitted):.2g}°"
        return found, "Leave out --keep-base or --keep-leds, or correct what it keeps."
    if np.ptp(readings.q, axis=0).max() < MAX_FROZEN:
        return "; the readings never change", "Log the encoders while the robot moves."
    tried = [(_difference(restart(q)), name, do) for name, do, q in joint_mistakes(readings)]
    least, name, remedy = min(tried)
    if least > MAX_LEFT_SHARE * _difference(start):
        least, name, remedy = min(_zeros(readings, restart), default=(np.inf, "", ""))
    if least > MAX_LEFT_SHARE * _difference(start):
        return None
    return f"; {name} fits: {np.rad2deg(least):.2g}° instead", remedy


def _zeros(readings: Readings, restart: Restart) -> Iterator[tuple[float, str, str]]:
    """What is left, name, remedy of each joint's best zero, where no joint error is as large.

    Those of the first and the last joint are turns of base and LEDs, and leave no trace.
    """
    for j, one in list(enumerate(np.eye(readings.q.shape[1])))[1:-1]:

        def left(by: float, one: Array = one) -> float:
            return _difference(restart(Readings(readings.t, readings.q + by * one)))

        found = minimize_scalar(left, bounds=(-MAX_OFFSET, MAX_OFFSET), options={"xatol": TOL_ZERO})
        if abs(found.x) > MAX_TURN_DIFFERENCE:
            name = f"joint {j + 1} with its zero moved by about {np.rad2deg(found.x):+.0f}°"
            yield float(found.fun), name, f"Set the zero of joint {j + 1} anew."


def refuse_misfit(
    adjusted: AdjustedRegistration,
    folder: Path,
    start: RegistrationStart,
    readings: Readings,
    restart: Restart,
) -> None:
    """Raise InputError for LEDs farther from their predicted pixels than joint errors explain.

    `restart` gives the start with other readings, neither base nor LEDs held.
    """
    used = adjusted.spotted.used
    left, lost = adjusted.predicted.residual[used], int((~used).sum())
    distance = rms(left) if len(left) else np.inf
    found = f"the readings put the LEDs {distance:.1f} px (rms) from where they are seen"
    expected = f"{MAX_RMS_PX:.0f} px are the worst that joint errors explain"
    refused = distance > MAX_RMS_PX
    if not refused and lost > MAX_REFUSED_SHARE * len(used):
        refused, found = True, f"{lost} of {len(used)} spots contradict the others"
        expected = "most must be of one body that moves as the readings say, seen by this rig"
    if not refused and adjusted.chi2 < MAX_MISFIT**2 * adjusted.degrees_of_freedom:
        return
    named = _name_mistake(start, readings, restart)
    if refused or named is not None:
        remedy = "Check the robot's name, the readings' unit (degrees) and order, and the rig."
        name, remedy = named or ("", remedy)
        expected = expected if refused else "readings of the motion that is seen are expected"
        raise InputError(folder / "encoders.csv", f"{found}{name}", expected, remedy)
