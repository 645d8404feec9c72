"""What a wrong link parameter does to every pair: the arm is not quite what its table says.

Standard DH, RotZ(θ) TransZ(d) TransX(a) RotX(α), with Hayati's RotY(β) behind it where the next
axis is parallel: there the common normal is nowhere in particular, and d slides along with the d of
the next joint. Source: Hayati, Robot arm geometric link parameter estimation, 22nd IEEE CDC, 1983.
"""

import numpy as np

import robots
from verify.judgement.faults import Fault
from verify.judgement.faults_common import base_motion, body_motion
from verify.judgement.links import link_frames, shift, turn
from verify.judgement.model import Model
from verify.records import Array

PARALLEL = np.sin(np.deg2rad(10.0))  # below, two axes count as parallel


def link_faults(model: Model, arm: robots.DhArm) -> list[Fault]:
    """One fault a link parameter; values are what has to be added to the robot file."""
    comparison = model.comparison
    frames = link_frames(arm, comparison.q)
    tip = frames[:, -1, :3, 3]
    parallel = np.append(np.abs(np.sin(arm.alpha[:-1])) < PARALLEL, False)
    effects: list[tuple[int, str, str, Array]] = []
    for i in range(arm.dof):
        before, after = frames[:, i], frames[:, i + 1]
        lever = tip - after[:, :3, 3]
        effects.append((i, "a", "mm", shift(after[:, :3, 0])))
        effects.append((i, "alpha", "deg", turn(after[:, :3, 0], lever)))
        if parallel[i]:
            effects.append((i, "beta", "deg", turn(after[:, :3, 1], lever)))
        else:
            effects.append((i, "d", "mm", shift(before[:, :3, 2])))
    rows = [-model.white.rows(effect) for _, _, _, effect in effects]
    if model.through_encoders and not model.stands_in:
        rows = _registered_away(model, rows)
    return [
        Fault("dh", i + 1, unit, columns, parameter=f"{name}{i + 1}")
        for (i, name, unit, _), columns in zip(effects, rows, strict=True)
    ]


def _registered_away(model: Model, rows: list[Array]) -> list[Array]:
    """Take off what base and LEDs took in of it, as if they were registered by this motion.

    They were registered by another one, which is not known here; a length was as wrong then.
    """
    pose = model.comparison.base_T_jacobian
    taken = model.white.rows(np.concatenate([base_motion(pose), body_motion(pose)], axis=2))
    basis, size, _ = np.linalg.svd(taken, full_matrices=False)
    basis = basis[:, size > 1e-9 * size[0]]
    return [columns - basis @ (basis.T @ columns) for columns in rows]
