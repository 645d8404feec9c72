"""Identify an arm: registration, joint offsets, geometry, and which of them the data call for.

Three models are fitted, each within the next: base and tool alone; with the joints' offsets; with
all of the arm's geometry. Which parameters are supported is decided at the arm's nominal numbers,
where parallel axes are parallel. A larger model m is chosen where the Bayesian information
criterion falls by 10 or more, all with the noise that the largest model leaves:

    criterion(m) = sum of min(chi²_i, 25) + L_m ln(measured numbers)
"""

from dataclasses import dataclass, replace

import numpy as np

from verify.calibration.kinematics.chain import (
    ArmState,
    KinematicChain,
    Parameter,
    geometry_parameters,
    offset_parameters,
    registration_parameters,
)
from verify.calibration.kinematics.fit import (
    CrossValidation,
    KinematicFit,
    fit_parameters,
    hold_out,
    pose_residuals,
    whitened_columns,
)
from verify.calibration.kinematics.identifiability import (
    Identifiability,
    identifiability,
    information_root,
    observability_indices,
)
from verify.calibration.kinematics.model import start_state
from verify.calibration.kinematics.poses import IdentificationPoses, NoiseScale
from verify.core.records import Array

LEVELS = ("registration", "offsets", "geometry")
MAX_CHI2 = 25.0  # χ² that a row may bring: noise brings a full pose's beyond it in 3 of 10,000
MIN_NUMBERS_PER_PARAMETER = 2  # measured: with fewer, residuals do not judge a model
MIN_CRITERION_DROP = 10.0  # by which the information criterion must fall for a larger model


@dataclass(frozen=True, slots=True)
class IdentificationOptions:
    """What is free, which model to take, and how it is cross-validated."""

    free_base: bool = True
    free_tool: bool = True
    level: str | None = None  # of `LEVELS`; None: the one that the data call for
    splits: int = 10  # of the hold-out; 0: none
    share: float = 0.3  # of the rows that are held out
    seed: int = 1


@dataclass(frozen=True, slots=True)
class LevelResult:
    """One model: its parameters, its fit, its residuals on rows held out."""

    name: str
    support: Identifiability
    fit: KinematicFit
    criterion: float  # Bayesian information criterion, less is better
    held_out: CrossValidation | None


@dataclass(frozen=True, slots=True)
class IdentificationResult:
    """All models and the chosen one."""

    levels: tuple[LevelResult, ...]  # smallest first
    chosen: LevelResult
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
    options: IdentificationOptions | None = None,
    known: ArmState | None = None,
) -> IdentificationResult:
    """Identify the parameters that the data support.

    Args:
        chain: the arm as its file has it.
        poses: n rows.
        options: what is free, and what to choose.
        known: bases and tools to start from, or to hold; found from the rows where not given.

    Raises:
        ValueError: too few rows for what is free.
    """
    options = options or IdentificationOptions()
    begun = replace(known, chain=chain) if known is not None else start_state(chain, poses)
    placed = _registration(begun, poses, options)
    registered = fit_parameters(begun, poses, placed)
    with_offsets = (*placed, *offset_parameters(chain))
    candidates = (placed, with_offsets, (*with_offsets, *geometry_parameters(chain)))
    supports = [_identifiability(registered, poses, c) for c in candidates]
    fits = [fit_parameters(registered.state, poses, s.supported) for s in supports]
    levels = tuple(
        LevelResult(
            name,
            support,
            fit,
            _criterion(fit, poses, fits[-1].scale),
            hold_out(fit.state, poses, fit.parameters, options.splits, options.share, options.seed),
        )
        for name, support, fit in zip(LEVELS, supports, fits, strict=True)
    )
    best = options.level or _best({level.name: level.criterion for level in levels})
    chosen = next(level for level in levels if level.name == best)
    return IdentificationResult(
        levels,
        chosen,
        observability_indices(chosen.fit.information, int(chosen.fit.used.sum())),
        pose_residuals(levels[0].fit.state, poses),
        pose_residuals(chosen.fit.state, poses),
    )


def register(
    chain: KinematicChain,
    poses: IdentificationPoses,
    options: IdentificationOptions | None = None,
    known: ArmState | None = None,
) -> KinematicFit:
    """Fit base and tool alone: how a given arm fits other data.

    Args:
        chain: the arm, corrected or not.
        poses: n rows.
        options: which of base and tool are free; both where not given.
        known: bases and tools to start from, or to hold; found from the rows where not given.

    Raises:
        ValueError: too few rows.
    """
    begun = replace(known, chain=chain) if known is not None else start_state(chain, poses)
    return fit_parameters(
        begun, poses, _registration(begun, poses, options or IdentificationOptions())
    )


def _registration(
    state: ArmState, poses: IdentificationPoses, options: IdentificationOptions
) -> tuple[Parameter, ...]:
    found: list[Parameter] = []
    for kind, count, free in (
        ("base", len(state.base), options.free_base),
        ("tool", len(state.tool), options.free_tool),
    ):
        if free:
            found += registration_parameters(kind, count, position_only=poses.position_only)
    return tuple(found)


def _identifiability(
    registered: KinematicFit, poses: IdentificationPoses, candidates: tuple[Parameter, ...]
) -> Identifiability:
    """Choose what the rows support, at the arm's nominal numbers and the stated noise."""
    scale = registered.scale if not poses.stated else NoiseScale(1.0, 1.0)
    design, nuisance = whitened_columns(registered.state, poses, candidates, scale)
    return identifiability(candidates, information_root(design, nuisance))


def _criterion(found: KinematicFit, poses: IdentificationPoses, scale: NoiseScale) -> float:
    """χ² at one noise for all models, plus ln(numbers) a parameter; inf: too few numbers."""
    by_row = np.sum(scale.whiten(poses, pose_residuals(found.state, poses)) ** 2, axis=1)
    numbers = int(poses.dimensions.sum())
    if numbers < MIN_NUMBERS_PER_PARAMETER * len(found.parameters):
        return float("inf")
    # an outlying row weighs the same in every model
    return float(np.minimum(by_row, MAX_CHI2).sum() + len(found.parameters) * np.log(numbers))


def _best(criteria: dict[str, float]) -> str:
    best = LEVELS[0]
    for name in LEVELS[1:]:
        if criteria[name] < criteria[best] - MIN_CRITERION_DROP:
            best = name
    return best
