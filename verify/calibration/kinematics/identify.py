"""Identify an arm: registration, joint offsets, geometry, and which of them the data call for.

Three models are fitted, each within the next: base and tool alone; with the joints' offsets; with
all of the arm's geometry. All are adjusted together, the arm's own numbers held by weak priors
(`Parameter.prior`); gauges alone are held. Rank and gauges are stated at the arm's nominal
numbers, where parallel axes are parallel. The largest model that the data can judge is fitted
first: noise and outlying rows are what it leaves. The model that predicts held-out poses best is
chosen.
"""

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from verify.analysis.uncertainty.sources import UnstatedEffect
from verify.calibration.kinematics.chain import (
    AXES,
    ArmState,
    KinematicChain,
    Parameter,
    geometry_parameters,
    offset_parameters,
    registration_parameters,
)
from verify.calibration.kinematics.fit import (
    KinematicFit,
    fit_parameters,
    information,
    pose_residuals,
    scaled_columns,
    tolerances,
)
from verify.calibration.kinematics.identifiability import (
    Identifiability,
    UnidentifiableParameter,
    identifiability,
    observability_indices,
    unsupported,
)
from verify.calibration.kinematics.model import predict_with_jacobian, start_state
from verify.calibration.kinematics.noise import initial_scale
from verify.calibration.kinematics.poses import IdentificationPoses
from verify.calibration.kinematics.validation import (
    CrossValidation,
    HoldOut,
    best_model,
    hold_out,
    with_scatter,
)
from verify.core.records import Array, take_rows

SCALE, LENGTH, ANGLE = 1e-3, 1e-3, float(np.radians(0.1))  # share, m, rad: what is asked after
LEVELS = ("registration", "offsets", "geometry")
MIN_PRIOR_SHARE = 0.5  # of a prior's standard deviation: what is left of it where poses say little
MIN_NUMBERS_PER_PARAMETER = 1.5  # measured: with fewer, residuals do not judge a model
# where positions and turns each show their own noise: either half could else be fitted exactly, a
# tenth left out as outlying, and its noise would be none
MIN_NUMBERS_OF_TWO_NOISES = 2.2


@dataclass(frozen=True, slots=True)
class IdentificationOptions(HoldOut):
    """What is free, which model to take, and how it is cross-validated."""

    free_base: bool = True
    free_tool: bool = True
    level: str | None = None  # of `LEVELS`; None: the one that predicts best


@dataclass(frozen=True, slots=True)
class LevelResult:
    """One model: its parameters, its fit, its residuals on rows held out."""

    name: str
    support: Identifiability
    fit: KinematicFit
    held_out: CrossValidation | None

    @property
    def known(self) -> Array:
        """`information_root` of the supported parameters, scaled by tolerance."""
        own = [self.fit.parameters.index(p) for p in self.support.supported]
        return self.fit.information[:, own]

    @property
    def weak(self) -> tuple[UnidentifiableParameter, ...]:
        """The arm's own parameters that rest on their priors more than on the poses."""
        fitted, known = self.fit.parameters, self.known
        own = tuple(fitted[fitted.index(p)] for p in self.support.supported)
        others = [[i for i in range(len(own)) if i != k] for k in range(len(own))]
        found = (unsupported(own, known, k, rest) for k, rest in enumerate(others))
        return tuple(
            one
            for one in found
            if not one.parameter.axis
            and one.uncertainty_if_free > MIN_PRIOR_SHARE * one.parameter.prior
        )


@dataclass(frozen=True, slots=True)
class IdentificationResult:
    """All models and the chosen one."""

    levels: tuple[LevelResult, ...]  # smallest first
    richest: KinematicFit  # of the largest model that the data can judge
    chosen: LevelResult
    best: LevelResult  # that predicts poses held out best
    observability: dict[str, float]
    before: Array  # (n, 6), m and rad: left by registration alone
    after: Array  # (n, 6): left by the chosen model

    @property
    def chain(self) -> KinematicChain:
        """The corrected arm."""
        return self.chosen.fit.state.chain

    def level(self, name: str) -> LevelResult:
        """One of the models."""
        return next(level for level in self.levels if level.name == name)


def identify_arm(
    chain: KinematicChain,
    poses: IdentificationPoses,
    options: IdentificationOptions = IdentificationOptions(),
    known: ArmState | None = None,
) -> IdentificationResult:
    """Identify the parameters of the arm that the data support.

    Bases and tools start from `known`, or are held there; found from the rows where not given.

    Raises:
        ValueError: too few rows for what is free.
    """
    begun = replace(known, chain=chain) if known is not None else start_state(chain, poses)
    supports = _supports(begun, poses, _registration(begun, poses, options))
    fitted = [_fitted(support) for support in supports]
    one_noise = poses.stated or poses.position_only
    distinct = int(poses.dimensions[poses.first_visits].sum()) / MIN_NUMBERS_PER_PARAMETER
    numbers = min(distinct, poses.numbers / (1.0 if one_noise else MIN_NUMBERS_OF_TWO_NOISES))
    judged = [len(support.supported) <= numbers for support in supports]
    largest = [f for f, enough in zip(fitted, judged, strict=True) if enough] or fitted[:1]
    richest = fit_parameters(begun, poses, largest[-1])

    def level(name: str, free: tuple[Parameter, ...], support: Identifiability) -> LevelResult:
        fit = richest if free == largest[-1] else fit_parameters(begun, poses, free, richest)
        tried = free in largest
        held_out = hold_out(fit, poses, richest.scale, options) if tried else None
        return LevelResult(name, support, with_scatter(fit, poses), held_out)

    levels = tuple(map(level, LEVELS, fitted, supports))
    best = levels[best_model([level.held_out for level in levels], poses.block)]
    chosen = best if options.level is None else levels[LEVELS.index(options.level)]
    return IdentificationResult(
        levels,
        richest,
        chosen,
        best,
        observability_indices(chosen.known, int(chosen.fit.used.sum())),
        pose_residuals(levels[0].fit.state, poses),
        pose_residuals(chosen.fit.state, poses),
    )


def register(
    chain: KinematicChain,
    poses: IdentificationPoses,
    options: IdentificationOptions = IdentificationOptions(),
    known: ArmState | None = None,
) -> KinematicFit:
    """Fit base and tool alone: how a given arm, corrected or not, fits other data.

    Both are free where no options are given; they start from `known`, or are held there, and are
    found from the rows where not given.

    Raises:
        ValueError: too few rows.
    """
    begun = replace(known, chain=chain) if known is not None else start_state(chain, poses)
    return fit_parameters(begun, poses, _registration(begun, poses, options))


def _registration(
    state: ArmState, poses: IdentificationPoses, options: IdentificationOptions
) -> tuple[Parameter, ...]:
    bases = len(state.base) if options.free_base else 0
    tools = len(state.tool) if options.free_tool else 0
    return tuple(registration_parameters(bases, tools, position_only=poses.position_only))


def _supports(
    state: ArmState, poses: IdentificationPoses, placed: tuple[Parameter, ...]
) -> list[Identifiability]:
    """Which parameters of each model no others make up, at the arm's present numbers."""
    offsets = (*placed, *offset_parameters(state.chain))
    largest = (*offsets, *geometry_parameters(state.chain))
    known = information(state, poses, largest, initial_scale(poses))
    return [
        identifiability(largest[:count], known[:, :count], 0.0)
        for count in (len(placed), len(offsets), len(largest))
    ]


def _fitted(support: Identifiability) -> tuple[Parameter, ...]:
    """Those supported, and those that others of the arm make up.

    Of several d along axes that are parallel in the file, and not quite so in the arm, each moves
    the offsets a little: all are fitted, held by their priors, and the offsets are as doubtful as
    that makes them. What base and tool take in alone stays as it is.
    """
    shared = [h.parameter for h in support.held if any(not p.axis for p, _ in h.confounded_with)]
    return (*support.supported, *shared)


def unstated_effects(
    fit: KinematicFit, poses: IdentificationPoses, scales: Iterable[str], held: dict[str, str]
) -> list[UnstatedEffect]:
    """What errors of 0.1 %, 1 mm or 0.1° would do to the offsets of the chosen model's fit.

    `scales` are sources of an unknown scale of all positions; `held` sources by "base" or "tool",
    where that is held as if exact.

        δp = (D'D + σ⁻²)⁻¹ D' W c

    with c (n, 6) the change that a scale off by 0.1 %, or a held base or target off by 1 mm or
    0.1°, makes to the measured poses.
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
