"""What would move the identified offsets, of what nobody states an uncertainty of.

    δp = (D'D + σ⁻²)⁻¹ D' W c

with c (n, 6) the change that a scale off by 0.1 %, or a held base or target off by 1 mm or 0.1°,
makes to the measured poses. No data tell how far it is off; this tells how far would matter.
"""

from collections.abc import Iterable

import numpy as np

from verify.analysis.uncertainty.sources import UnstatedEffect
from verify.calibration.kinematics.chain import AXES, Parameter
from verify.calibration.kinematics.fit import KinematicFit, scaled_columns, tolerances
from verify.calibration.kinematics.model import predict_with_jacobian
from verify.calibration.kinematics.poses import IdentificationPoses
from verify.core.records import Array, take_rows

SCALE, LENGTH, ANGLE = 1e-3, 1e-3, float(np.radians(0.1))  # share, m, rad: what is asked after


def unstated_effects(
    fit: KinematicFit, poses: IdentificationPoses, scales: Iterable[str], held: dict[str, str]
) -> list[UnstatedEffect]:
    """What errors of 0.1 %, 1 mm or 0.1° would do to the offsets of the chosen model's fit.

    `scales` are sources of an unknown scale of all positions; `held` sources by "base" or "tool",
    where that is held as if exact.
    """
    offsets = [k for k, p in enumerate(fit.parameters) if p.kind == "correction"]
    if not offsets:
        return []
    rows = take_rows(poses, fit.used)
    white = fit.scale.of(rows)
    _, columns = scaled_columns(fit.state, rows, fit.parameters)
    design = (white @ np.concatenate([columns, rows.nuisance], axis=2)).reshape(6 * len(rows), -1)
    weight = np.ones(design.shape[1])
    weight[: len(fit.parameters)] = [(p.tolerance / p.prior) ** 2 for p in fit.parameters]
    normal = design.T @ design + np.diag(weight)

    def moved(change: Array) -> tuple[int, float]:
        found = np.linalg.solve(normal, design.T @ (white @ change).reshape(6 * len(rows), -1))
        angles = np.abs(found[offsets] * tolerances(fit.parameters)[offsets, None]).max(axis=1)
        worst = int(np.argmax(angles))
        return fit.parameters[offsets[worst]].place, float(angles[worst])

    effects = []
    for source in scales:
        change = np.zeros((len(rows), 6, 1))
        places = rows.world_T_target[:, :3, 3]
        change[:, :3, 0] = SCALE * (places - places.mean(axis=0))
        effects.append(UnstatedEffect(source, "0.1 % of scale", *moved(change)))
    for kind, source in held.items():
        for error, size, axes in (("1 mm", LENGTH, AXES[:3]), ("0.1°", ANGLE, AXES[3:])):
            moves = tuple(Parameter(kind, 0, axis) for axis in axes)
            change = predict_with_jacobian(fit.state, rows.q, rows.base, rows.tool, moves)[1]
            effects.append(UnstatedEffect(source, error, *moved(size * change)))
    return effects
