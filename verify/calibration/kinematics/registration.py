"""Register a robot by another instrument's poses: its base, and the target on the flange.

    measured = base · arm(q) · target

base and target are fitted, the arm's table is held. With the whitened columns H (rows, placements)
and J (rows, joints) of the predicted poses, nuisances taken out:

    G = H⁺ J                       a joint that reads too high by d moved base and target by -G d
    |J - H G| / |J|                share of a constant offset that stays visible, joint by joint
"""

import hashlib
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from robots.transforms import cross_matrix
from verify.calibration.kinematics.chain import AXES, chain_of, offset_parameters
from verify.calibration.kinematics.fit import (
    KinematicFit,
    information,
    pose_residuals,
    tolerances,
    without_nuisances,
)
from verify.calibration.kinematics.identify import IdentificationOptions, register
from verify.calibration.kinematics.placements import moved_rig, registered_session
from verify.calibration.kinematics.sessions import CombinedPoses, deflate_repetition, tool_open
from verify.calibration.origin import DEG, MM
from verify.calibration.registration.refusals import MAX_UNCERTAINTY, refuse_undetermined
from verify.calibration.registration.uncertainty import MIN_VISIBLE_SHARE
from verify.core.records import Array, Index, take_rows
from verify.core.rig import Rig
from verify.errors import InputError
from verify.io.session.session import Session

MIN_POSES = 6  # three determine base and target, as many check them
MAX_RESIDUAL = 0.02  # m, rms: an arm of 1 m with 2° in a joint leaves about as much


@dataclass(frozen=True, slots=True)
class PosesRegistration:
    """Base and target from an instrument's poses, and the joint errors that this hides."""

    fit: KinematicFit
    rig: Rig  # the robot's base in the instrument's frame, with its covariance and absorption
    text: bytes  # session.toml with base and target as found
    visible_fractions: Array  # (j,), of a constant offset that was there already
    frame: Index  # (n,), number of each pose
    residual: Array  # (n, 6), m and rad: measured less registered
    rms: tuple[float, float]  # m, rad, of the poses used
    left_out: tuple[int, ...]  # numbers of poses that do not belong to the others
    decisions: tuple[str, ...]
    warnings: tuple[str, ...]


def register_poses(
    gathered: CombinedPoses, *, keep_base: bool = False, keep_target: bool = False
) -> PosesRegistration:
    """Register a robot by one session of poses; the base or the target may be kept as stated.

    Raises:
        InputError: too few poses, a motion that leaves base or target undetermined, poses that are
            not this arm's motion, or what is to be kept is not known independently.
    """
    session, rows = gathered.sessions[0].session, gathered.poses
    place = str(session.folder / "encoders.csv")
    _check_kept(session, keep_base=keep_base, keep_target=keep_target)
    if (count := len(rows.first_visits)) < MIN_POSES:
        found = f"{count} different postures with readings"
        raise InputError(session.folder, found, f"{MIN_POSES} at least", "Record more of them.")
    options = IdentificationOptions(free_base=not keep_base, free_tool=not keep_target)
    chain = chain_of(session.arm)
    known = gathered.state(chain) if keep_base or keep_target else None
    fit = register(chain, rows, options, known)
    farthest = _rms(_residuals(fit, gathered), fit)[0]
    if farthest > MAX_RESIDUAL:
        raise InputError(
            place,
            f"{farthest * MM:.3g} mm (rms) of the poses are left, wherever base and target are",
            f"{MAX_RESIDUAL * MM:.0f} mm are the worst that joint errors explain",
            f'Check that "{session.robot}" is the robot that moved, and units, signs and order.',
        )
    if known is None and not rows.position_only:
        refuse_undetermined(session.arm, rows.q[fit.used], _noise(fit, gathered), place)
    gathered = deflate_repetition(gathered, fit)
    fit = register(chain, gathered.poses, options, known)
    _refuse_open(session, fit)
    left = _residuals(fit, gathered)
    rms = _rms(left, fit)
    absorbed, shares = _absorption(fit, gathered)
    rig = session.rig if keep_base else moved_rig(session.rig, fit, 0)
    rig = replace(rig, absorption=absorbed, registration=None)
    stated = rows.stated
    digest = hashlib.sha256(registered_session(session, fit, rig, stated=stated)).hexdigest()
    rig = replace(rig, registration=f"sha256:{digest}")
    return PosesRegistration(
        fit=fit,
        rig=rig,
        text=registered_session(session, fit, rig, stated=stated),
        visible_fractions=shares,
        frame=gathered.frame,
        residual=left,
        rms=rms,
        left_out=tuple(gathered.frame[~fit.used].tolist()),
        decisions=tuple(_decisions(fit, gathered, rms, keep_base=keep_base, kept=keep_target)),
        warnings=tuple(_warnings(fit, gathered)),
    )


def _check_kept(session: Session, *, keep_base: bool, keep_target: bool) -> None:
    if keep_base and keep_target:
        raise InputError("--keep-base, --keep-leds", "nothing is left to register", "one of them")
    if keep_base and session.rig.base_source != "fixture":
        found = "no base that was found independently of the encoders is stated"
        raise InputError(
            "--keep-base", found, '[robot_base] with source = "fixture"', "Fit it too."
        )
    if keep_target and tool_open(session):
        found = "no target that was placed independently of the encoders is stated"
        expected = 'point_mm in [poses], and no source = "motion"'
        raise InputError("--keep-leds", found, expected, "Fit it too.")


def _residuals(fit: KinematicFit, gathered: CombinedPoses) -> Array:
    """Measured poses less registered ones, (n, 6), m and rad, without the nuisances' effects."""
    left = pose_residuals(fit.state, gathered.poses)
    return without_nuisances(left, gathered.poses, fit.scale, fit.used)


def _rms(left: Array, fit: KinematicFit) -> tuple[float, float]:
    place, turn = (np.linalg.norm(part, axis=1)[fit.used] for part in np.split(left, 2, axis=1))
    return float(np.sqrt(np.mean(place**2))), float(np.sqrt(np.mean(turn**2)))


def _noise(fit: KinematicFit, gathered: CombinedPoses) -> tuple[float, float]:
    """Standard uncertainty of a pose: m, rad."""
    white = fit.scale.of(gathered.poses)[fit.used]
    weight = np.median(np.einsum("nki,nki->ni", white, white), axis=0)
    noise = 1 / np.sqrt(np.maximum(weight, 1e-12))
    return float(noise[:3].mean()), float(noise[3:].mean())


def _refuse_open(session: Session, fit: KinematicFit) -> None:
    """Refuse base or target known worse than the limits, which no later run could do with."""
    limits = np.array([MAX_UNCERTAINTY[AXES.index(p.axis) // 3] for p in fit.parameters])
    names = [p.name for p, u, most in zip(fit.parameters, fit.standard_uncertainty, limits,
                                          strict=True) if u > most]  # fmt: skip
    if names:
        raise InputError(
            session.folder / "encoders.csv", f"the motion leaves {', '.join(names)} undetermined",
            "base and target together need turns about two axes that are not parallel",
            "Record a motion of more joints, or keep one: --keep-base or --keep-leds.",
        )  # fmt: skip


def _absorption(fit: KinematicFit, gathered: CombinedPoses) -> tuple[Array, Array]:
    """What base and target make up of joint offsets, and what is left of these.

    Returns motion of base and body a radian, (12, j), as rig.toml has it, and shares (j,).
    """
    placed, offsets = fit.parameters, tuple(offset_parameters(fit.state.chain))
    rows, count = take_rows(gathered.poses, fit.used), len(placed)
    root = information(fit.state, rows, (*placed, *offsets), fit.scale)
    own, joints = root[:, :count], root[:, count:]
    taken = np.linalg.lstsq(own, joints, rcond=None)[0]
    whole = np.linalg.norm(joints, axis=0)
    shares = np.divide(
        np.linalg.norm(joints - own @ taken, axis=0), whole, out=0 * whole, where=whole > 0
    )
    taken = taken * tolerances(placed)[:, None] / tolerances(offsets)
    motion = np.zeros((12, len(offsets)))
    for parameter, row in zip(placed, taken, strict=True):
        motion[AXES.index(parameter.axis) + 6 * (parameter.kind == "tool")] = row
    turn = gathered.sessions[0].session.rig.rig_T_base[:3, :3] @ fit.state.base[0][:3, :3]
    motion[:3], motion[3:6] = turn @ motion[:3], turn @ motion[3:6]
    # the target's turns are about its own place, a body's are about the flange's origin
    motion[6:9] += cross_matrix(fit.state.tool[0][None, :3, 3])[0] @ motion[9:]
    return motion, np.where(shares < MIN_VISIBLE_SHARE, 0.0, np.minimum(shares, 1.0))


def _decisions(
    fit: KinematicFit,
    gathered: CombinedPoses,
    rms: tuple[float, float],
    *,
    keep_base: bool,
    kept: bool,
) -> Iterator[str]:
    what = "positions" if gathered.poses.position_only else "poses"
    turns = "" if gathered.poses.position_only else f" and {rms[1] * DEG:.4f}°"
    yield f"{int(fit.used.sum())} {what} used, {rms[0] * MM:.4f} mm{turns} rms."
    if not keep_base:
        base = gathered.sessions[0].session.rig.rig_T_base @ fit.state.base[0]
        turn = Rotation.from_matrix(base[:3, :3]).as_rotvec(degrees=True)
        place = ", ".join(f"{x:.3f}" for x in base[:3, 3] * MM)
        vector = ", ".join(f"{x:.4f}" for x in turn)
        yield f"Base in the instrument's frame: ({place}) mm, rotation vector ({vector})°."
    if keep_base:
        yield "The robot base stands as session.toml has it; the target is fitted."
    if kept:
        yield "The target stands as session.toml has it; the base is fitted."
    if outlying := int((~fit.used).sum()):
        yield f"{outlying} of {len(fit.used)} do not belong to the others: left out."


def _warnings(fit: KinematicFit, gathered: CombinedPoses) -> Iterator[str]:
    scale = max(fit.scale.position, fit.scale.orientation)
    if gathered.poses.stated and scale > 1:
        yield (
            f"The residuals are {scale:.1f} times what was stated of the poses: the robot's joints "
            "or its table are off, or the instrument is; uncertainties are enlarged by it."
        )
    if not gathered.poses.stated:
        yield (
            "The noise of the poses is not stated: taken from what base and target leave, the "
            "robot's own errors with it."
        )
