"""Check an arm's kinematics against itself and pinocchio; compute how far it reaches."""

from dataclasses import dataclass

import numpy as np

from robots.arm import Arm, DhArm, UrdfArm
from robots.inverse import FAMILIES, inverse, near
from robots.kinematics import forward, jacobian
from robots.nearest import nearest
from robots.pinocchio_model import pinocchio_model
from robots.transforms import Array, difference

# rad: an answer this near to the joints that made the pose is taken for them
MAX_JOINT_DIFFERENCE = 1e-6
MIN_DETERMINANT = 1e-3  # of the greatest |det J|: below, the joints lose digits, not the pose
# the same of a URDF: least singular value of J over its greatest, where its angles are exact or not
MIN_SINGULAR_RATIO = {True: 1e-4, False: 1e-2}
START_SIGMA = 0.05  # rad a joint, standard deviation: where an iteration for a URDF starts
DIFFERENCE_STEP = 1e-6  # rad, of central differences: truncation and rounding are both near 1e-10
MAX_ITERATED_POSES = 50  # poses for a check that iterates


@dataclass(frozen=True)
class SelfCheck:
    """The worst disagreement over random poses within the limits."""

    poses: int
    inverse_position: float  # m, a solution's forward kinematics against the pose to be reached
    inverse_rotation: float  # rad
    lost: int  # poses whose own joints were not among the answers, singular ones left out
    pinocchio_position: float  # m, forward kinematics against pinocchio's
    pinocchio_rotation: float  # rad
    pinocchio_jacobian: float  # m/rad or rad/rad, the Jacobian against pinocchio's
    difference_jacobian: float  # the same against central differences of forward


@dataclass(frozen=True)
class Reach:
    """How far an arm reaches, joint limits left aside."""

    minimum: float  # m
    maximum: float  # m
    meaning: str  # from where to where


def reach(arm: Arm) -> Reach:
    """Say how far the arm reaches.

    For a DH arm the two links' exact range: from axis 2 to the wrist centre (spherical wrist) or to
    axis 4 (parallel axes), in the arm's plane; a pose outside it has no solution on that side. For
    a URDF an upper bound: the way from joint origin to joint origin, first joint to tip.
    """
    if isinstance(arm, DhArm):
        end = "wrist centre" if arm.family == "spherical_wrist" else "axis 4"
        return Reach(*FAMILIES[arm.family].reach(arm), f"axis 2 to {end}")
    assert isinstance(arm, UrdfArm)
    steps = [arm.model.jointPlacements[arm.model.getJointId(name)] for name in arm.joint_names[1:]]
    steps.append(arm.model.frames[arm.tip_frame].placement)
    longest = float(sum(np.linalg.norm(step.translation) for step in steps))
    return Reach(0.0, longest, f"joint 1 to {arm.tip}, at most")


def self_check(arm: Arm, poses: int = 1000, seed: int = 0) -> SelfCheck:
    """Try an arm's kinematics on so many random poses, uniform within the joints' limits.

    A URDF's arm that is solved by iteration gets at most 50 of them for that part.
    """
    random = np.random.default_rng(seed)
    q = random.uniform(arm.lower, arm.upper, (poses, arm.dof))
    base_T_flange, moves = forward(arm, q), jacobian(arm, q)
    theirs, their_moves = _pinocchio(arm, q)
    against = *_worst(base_T_flange, theirs), float(np.abs(moves - their_moves).max())
    if isinstance(arm, DhArm) or (isinstance(arm, UrdfArm) and arm.closed_form):
        solved = _closed_form(arm, q, base_T_flange, moves)
    else:
        solved = _check_iteration(
            arm, q[:MAX_ITERATED_POSES], base_T_flange[:MAX_ITERATED_POSES], random
        )
    slopes = _numeric_jacobian(arm, q[:MAX_ITERATED_POSES])
    return SelfCheck(
        poses, *solved, *against, float(np.abs(moves[:MAX_ITERATED_POSES] - slopes).max())
    )


def _worst(base_T_b: Array, base_T_c: Array) -> tuple[float, float]:
    apart = difference(base_T_b, base_T_c)
    position, rotation = (np.linalg.norm(part, axis=-1) for part in np.split(apart, 2, axis=-1))
    return float(position.max(initial=0)), float(rotation.max(initial=0))


def _closed_form(arm: Arm, q: Array, pose: Array, moves: Array) -> tuple[float, float, int]:
    branches = inverse(arm, pose, hold=q).q
    exists = np.isfinite(branches).all(axis=-1)
    targets = np.broadcast_to(pose[:, None], (*exists.shape, 4, 4))[exists]
    worst = _worst(forward(arm, branches[exists]), targets)
    away = np.abs(near(branches, q[:, None]) - q[:, None]).max(axis=-1)
    missing = ~(away < MAX_JOINT_DIFFERENCE).any(axis=-1) & _are_regular(arm, moves)
    return *worst, int(missing.sum())


def _are_regular(arm: Arm, moves: Array) -> Array:
    """Which postures, of Jacobians (m, 6, n), are away from a singularity."""
    if isinstance(arm, DhArm):
        least, most = FAMILIES[arm.family].reach(arm)
        scale = (most**2 - least**2) / 4 * most  # m³: the product of the two links and their sum
        return np.asarray(np.abs(np.linalg.det(moves)) > MIN_DETERMINANT * scale)
    assert isinstance(arm, UrdfArm)
    assert arm.closed_form is not None
    values = np.linalg.svd(moves[..., :6], compute_uv=False)
    return np.asarray(values[:, -1] > MIN_SINGULAR_RATIO[arm.closed_form.exact] * values[:, 0])


def _check_iteration(
    arm: Arm, q: Array, pose: Array, random: np.random.Generator
) -> tuple[float, float, int]:
    found, reached = nearest(arm, pose, q + random.normal(0, START_SIGMA, q.shape))
    return *_worst(forward(arm, found[reached]), pose[reached]), int((~reached).sum())


def _pinocchio(arm: Arm, q: Array) -> tuple[Array, Array]:
    import pinocchio

    model, world = pinocchio_model(arm), pinocchio.ReferenceFrame.LOCAL_WORLD_ALIGNED
    if isinstance(arm, UrdfArm):
        names, base, tip = arm.joint_names, arm.base_frame, arm.tip_frame
    else:
        names, base, tip = tuple(model.names)[1:], 0, model.getFrameId("flange")
    columns = [model.joints[model.getJointId(name)].idx_v for name in names]
    data, turn = model.createData(), np.zeros(model.nv)
    poses, moves = np.empty((len(q), 4, 4)), np.empty((len(q), 6, arm.dof))
    for i, angles in enumerate(arm.axis_angles(q)):
        turn[columns] = angles
        configuration = pinocchio.integrate(model, pinocchio.neutral(model), turn)
        moved = pinocchio.computeFrameJacobian(model, data, configuration, tip, world)
        pinocchio.updateFramePlacements(model, data)
        world_T_base = data.oMf[base]
        poses[i] = world_T_base.actInv(data.oMf[tip]).homogeneous
        by_part = moved.reshape(2, 3, -1)[..., columns]  # of one joint pinocchio gives a vector
        moves[i] = (world_T_base.rotation.T @ by_part).reshape(6, arm.dof)
    return poses, moves if arm.linkage is None else moves @ arm.linkage


def _numeric_jacobian(arm: Arm, q: Array) -> Array:
    nudges = DIFFERENCE_STEP * np.eye(arm.dof)
    ahead, behind = forward(arm, q[:, None] + nudges), forward(arm, q[:, None] - nudges)
    return np.swapaxes(difference(ahead, behind) / (2 * DIFFERENCE_STEP), -1, -2)
