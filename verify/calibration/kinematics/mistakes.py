"""Refuse readings that no base and target make this arm's motion, and name what explains them.

Before the fit, usual mistakes, one or two at once: base and target are free, so poses and readings
cannot be laid side by side, and each is judged by what a registration leaves of a few poses, the
best ones with the joints' offsets free. Two at once are sought by the angles between poses, which
no registration disturbs. After the fit, where its largest model leaves more than faulty readings
(`terms`) or another base and target than those held would, these are named.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from robots import Arm, forward
from robots.transforms import rotation_log
from verify.analysis.diagnosis.faults import MAX_OFFSET
from verify.analysis.mistakes import LEVER, joint_mistakes, pose_mistakes
from verify.calibration.kinematics.chain import (
    Parameter,
    chain_of,
    offset_parameters,
    registration_parameters,
)
from verify.calibration.kinematics.fit import pose_residuals
from verify.calibration.kinematics.identify import IdentificationResult
from verify.calibration.kinematics.model import start_state
from verify.calibration.kinematics.poses import IdentificationPoses
from verify.calibration.kinematics.sessions import CombinedPoses
from verify.calibration.kinematics.terms import MOVE_SIGMA, P_FALSE, TermFit, explain, fit_terms
from verify.core.readings import Readings
from verify.core.records import Array, Flags, take_rows
from verify.core.statistics import chi2_isf
from verify.errors import InputError

MIN_LEFT = 0.02  # m, mean: an arm of 1 m with 2° in a joint leaves about as much
MIN_FACTOR = 3.0  # of what is left as written over what a mistake leaves
MAX_ROWS = 80  # that are registered for each mistake
MIN_ROWS = 12  # of each session
MAX_CARRIED = 4  # mistakes, to a fit with the offsets free; sessions, to one without them
MIN_NEARER = 1.2  # a session that is off is named, where another base fits better by less
MIN_SHARE = 0.5  # of chi², that a scale or slip explains: parts of a real UR10's have up to 0.35
MIN_JUMP = np.deg2rad(2.0)  # of a joint between two poses: it says where it came from
MAX_PRIORS = 15.0  # standard deviations, 3 mm or 3°: what is off by more is another arm
REMEDIES = {
    "scale": "Undo the scale.",
    "slip": "Identify from the poses on one side of the slip.",
    **dict.fromkeys(("base", "target"), "Make the poses before and after it two sessions."),
}
MEND = "Mend the encoder or the gear, or judge the arm as it is by `verify run`."
MAX_PAIRED = 40  # poses, by which two mistakes at once are sought


@dataclass(frozen=True, slots=True)
class WithoutMistake:
    """Rows as they would be without a mistake, or two."""

    file: Path  # that holds it
    name: str
    remedy: str
    rows: IdentificationPoses


def refuse_mistaken_readings(file: Path, gathered: CombinedPoses) -> None:
    """Refuse readings, or poses, that fit far better once a usual mistake is taken back, or two.

    Raises:
        InputError: names the mistakes and what remains without them.
    """
    first = gathered.sessions[0].session
    every = np.ones(len(gathered.poses), dtype=bool)
    targets = gathered.poses.world_T_target.copy()
    for i, one in enumerate(gathered.sessions):  # an instrument's as its file has them
        if (instrument := one.session.instrument) is not None:
            targets[gathered.source == i] = instrument.poses.transforms[one.frame]
    some, t = _some(gathered, every)
    rows = take_rows(replace(gathered.poses, world_T_target=targets), some)
    written = _registered(first.arm, rows)
    if written < MIN_LEFT:
        return
    offset, limit = _with_offsets(first.arm, rows)
    if offset > MAX_OFFSET:  # no encoder is at fault by as much
        limit = written
    if limit < MIN_LEFT / MIN_FACTOR:
        return
    singles = list(_mistakes(file, gathered, rows))
    best, least = _best(first.arm, singles)
    if least > MIN_LEFT:
        two, left = _best(first.arm, _pairs(first.arm, singles, t))
        if left < MIN_LEFT:
            best, least = two, left
    if least * MIN_FACTOR < limit:
        found = f"{_mm(written)} of the poses, wherever base and target are"
        raise _refusal(best.file, f"{found}; {_fits(best.name, least)}", best.remedy)


def refuse_unfit(
    file: Path, gathered: CombinedPoses, found: IdentificationResult, *, held: bool
) -> list[str]:
    """Refuse readings that nothing which was identified makes this arm's motion.

    `held`: base or target were not free. Gives a warning where faults of readings explain less than
    half of what is left, and more than noise does. Outlying poses do not count.

    Raises:
        InputError: faults or another base explain most of what is left, or more is left than any
            arm's own errors leave.
    """
    chain, used = chain_of(gathered.sessions[0].session.arm), found.richest.used
    some, t = _some(gathered, used)
    rows, parameters = take_rows(gathered.poses, some), found.richest.parameters
    start = gathered.state(chain) if held else start_state(chain, rows)
    written = fit_terms(start, rows, parameters)
    size, most = _mm(_length(written.left, rows)), _misfit(written, rows) / MIN_FACTOR
    base, elsewhere = None, 0.0
    if held:
        free = (*_placed(rows), *(p for p in parameters if not p.axis))
        other = fit_terms(start_state(chain, rows), rows, free)
        gain = written.chi2(rows, other.scale) - other.chi2(rows, other.scale)
        if gain > max(other.freedom, float(chi2_isf(P_FALSE, len(free) - len(parameters)))):
            most = max(most, MIN_NEARER * _misfit(other, rows))
            elsewhere = _length(other.left, rows)
            fits = f"another base and target fit: {_mm(elsewhere)}"
            remedy = "Register again, or free both: --base free --leds free."
            base = _refusal(file, f"{size}, base and target held; {fits}", remedy)
    _refuse_disagreeing(
        gathered, some, written.left, most,
        lambda kept: fit_terms(start, take_rows(rows, kept), parameters),
    )  # fmt: skip
    alone = len(np.unique(rows.recording)) == 1
    direction = np.concatenate([one.comparison.direction for one in gathered.sessions])
    jump = np.diff(gathered.poses.q, axis=0, prepend=gathered.poses.q[:1])  # from visit to visit
    direction = np.where(np.abs(jump) > MIN_JUMP, np.sign(jump), direction)[some]
    explained = explain(written, start, rows, t, direction, parameters, slips=alone)
    named, rest = _words(explained, gathered), _length(explained.left, rows)
    if base is not None and rest > elsewhere:
        raise base
    length = _length(found.after[used], take_rows(gathered.poses, used))
    # of the motion of another arm anything explains a part
    if max(explained.share, default=0.0) >= MIN_SHARE and 2 * rest < max(length, MIN_LEFT):
        remedy = " ".join(dict.fromkeys(REMEDIES.get(one.kind, MEND) for one in explained.terms))
        raise _refusal(file, f"{size}; {_fits(named, rest)}", remedy)
    check = "Check units, signs and order in both files: more than one thing may be wrong."
    if length > MIN_LEFT:
        raise _refusal(file, f"{_mm(length)}; no usual mistake or fault explains it", check)
    for one, change in zip(found.chosen.fit.parameters, found.chosen.fit.change, strict=True):
        if not one.axis and abs(change) > MAX_PRIORS * replace(one, spread=None).prior:
            size = f"{change / one.tolerance:+.3g} {'°' if one.angular else 'mm'}"
            raise _refusal(file, f"only with {one.name} changed by {size} they would be", check)
    if not explained.terms:
        return []
    share = f"explains {explained.share.max():.0%} of the squared residuals"
    return [f"{named} {share}: offsets and lengths may be off by more than their U."]


def _refuse_disagreeing(
    gathered: CombinedPoses, some: Flags, left: Array, most: float, fit: Callable[[Flags], TermFit]
) -> None:
    """Refuse one of several sessions without which a fit to the rows kept misfits less than `most`.

    `left` (n, 6): what the fit to all rows leaves, m and rad. Of two sessions both are named.
    """
    rows = take_rows(gathered.poses, some)
    each = {int(k): rows.recording == k for k in np.unique(rows.recording)}
    off = sorted(each, key=lambda k: _length(left[each[k]], rows))[-MAX_CARRIED:]
    fits = {k: (fit(~each[k]), take_rows(rows, ~each[k])) for k in off if len(each) > 1}
    misfits = [_misfit(*fits[k]) for k in fits]
    if not fits or (max if len(each) == 2 else min)(misfits) > most:
        return
    k = off[int(np.argmin(misfits))]
    folders = [gathered.sessions[gathered.source[some][each[i]][0]].session.folder for i in each]
    place, rest = folders.pop(list(each).index(k)), _length(fits[k][0].left, fits[k][1])
    others, leave = "the other sessions", "Leave it out"
    if len(each) == 2:
        others, leave = str(folders[0]), "Leave one of them out"
    size = f"{_mm(_length(left, rows))} of all together, {rest * 1e3:.3g} mm without it"
    remedy = f"{leave}, or identify what was recorded before and after a change each by itself."
    raise InputError(place, f"does not agree with {others}: {size}", "", remedy)


def _misfit(fit: TermFit, rows: IdentificationPoses) -> float:
    """Mean length, m, of what a fit leaves, if it had no parameters; inf where it has too many."""
    factor = rows.dimensions.sum() / fit.freedom
    return _length(fit.left, rows) * float(np.sqrt(factor)) if factor < 2 else np.inf


def _some(gathered: CombinedPoses, used: Flags) -> tuple[Flags, Array]:
    """Which rows are looked at, (n,) of all, some used ones of each session; their instants, s."""
    t = np.concatenate([one.comparison.t for one in gathered.sessions])
    some, each = np.zeros(len(t), dtype=bool), max(MAX_ROWS // len(gathered.sessions), MIN_ROWS)
    for i in range(len(gathered.sessions)):
        own = np.flatnonzero((gathered.source == i) & used)
        some[own[np.unique(np.linspace(0, len(own) - 1, each).astype(int))]] = True
    return some, t[some]


def _mistakes(
    file: Path, gathered: CombinedPoses, rows: IdentificationPoses
) -> Iterator[WithoutMistake]:
    """The rows without each usual mistake."""
    readings = Readings(np.arange(len(rows), dtype=np.float64), rows.q)
    for name, do, without in joint_mistakes(readings):
        yield WithoutMistake(file, name, do, replace(rows, q=without.q))
    session = gathered.sessions[0].session
    if session.instrument is not None:
        for name, do, poses in pose_mistakes(rows.world_T_target, alone=rows.position_only):
            moved = replace(rows, world_T_target=poses)
            yield WithoutMistake(session.left.path, name, do, moved)


def _pairs(arm: Arm, singles: list[WithoutMistake], t: Array) -> list[WithoutMistake]:
    """Two mistakes at once, those by which the flange turns most nearly as the target does.

    Rows are at t (n,), s. Of positions alone, those with one of the best single mistakes.
    """
    rows = singles[0].rows
    if rows.position_only:
        singles = sorted(singles, key=lambda one: _registered(arm, one.rows))[:MAX_CARRIED]
    pairs = [
        replace(
            one, name=f"{one.name} and {name}", remedy=f"{one.remedy} {do}",
            rows=replace(one.rows, q=without.q),
        )
        for one in singles
        for name, do, without in joint_mistakes(Readings(t, one.rows.q))
    ]  # fmt: skip
    if rows.position_only:
        return pairs
    few = np.unique(np.linspace(0, len(rows) - 1, MAX_PAIRED).astype(int))
    q = np.concatenate([pair.rows.q[few] for pair in pairs])
    flange = forward(arm, q)[:, :3, :3].reshape(len(pairs), len(few), 3, 3)
    target = np.stack([pair.rows.world_T_target[few, :3, :3] for pair in pairs])
    flange_angle, target_angle = (  # between neighbours, (k, n - 1), rad
        np.linalg.norm(rotation_log(turns[:, :-1] @ np.swapaxes(turns[:, 1:], 2, 3)), axis=2)
        for turns in (flange, target)
    )
    apart = np.median(np.abs(flange_angle - target_angle), axis=1)
    return [pairs[k] for k in np.argsort(apart)[: 2 * MAX_CARRIED].tolist()]


def _best(arm: Arm, tried: list[WithoutMistake]) -> tuple[WithoutMistake, float]:
    """The mistake that leaves least of the poses, and how much, m, mean."""
    left = np.array([_registered(arm, one.rows) for one in tried])
    for k in np.argsort(left)[:MAX_CARRIED].tolist():
        offset, rest = _with_offsets(arm, tried[k].rows)
        if offset < MAX_OFFSET:
            left[k] = min(left[k], rest)
    best = int(np.argmin(left))
    return tried[best], float(left[best])


def _registered(arm: Arm, rows: IdentificationPoses) -> float:
    """What a registration leaves, m, mean."""
    return _length(pose_residuals(start_state(chain_of(arm), rows), rows), rows)


def _with_offsets(arm: Arm, rows: IdentificationPoses) -> tuple[float, float]:
    """The largest of the joints' offsets when these are free as well, rad, and what is left, m."""
    start = start_state(chain_of(arm), rows)
    bare = replace(rows, nuisance=rows.nuisance[:, :, :0])
    fit = fit_terms(start, bare, (*_placed(rows), *offset_parameters(start.chain)))
    return float(np.abs(fit.state.chain.correction).max()), _length(fit.left, rows)


def _placed(rows: IdentificationPoses) -> list[Parameter]:
    """The parameters of every base and target."""
    bases, tools = int(rows.base.max()) + 1, int(rows.tool.max()) + 1
    return registration_parameters(bases, tools, position_only=rows.position_only)


def _length(left: Array, rows: IdentificationPoses) -> float:
    """Mean length, m, of what is left, (n, 6): of places, and of turns at LEVER."""
    lever = LEVER if (rows.dimensions == 6).all() else 0.0
    return float((np.linalg.norm(left.reshape(-1, 2, 3), axis=2) @ [1.0, lever]).mean())


def _words(fit: TermFit, gathered: CombinedPoses) -> str:
    """The terms of a fit; slips by the number of the first pose after them."""
    t, words = gathered.sessions[0].comparison.t, []
    for term, x in zip(fit.terms, fit.x, strict=True):
        size = float(np.degrees(np.linalg.norm(x)))
        pose = int(gathered.frame[np.searchsorted(t, term.since or 0.0)]) + 1
        if term.joint < 0:
            shift, turn = np.linalg.norm(np.reshape(x * MOVE_SIGMA, (2, 3)), axis=1).tolist()
            by = f"by {shift * 1e3:.2g} mm and {np.degrees(turn):.2g}°"
            words.append(f"the {term.kind} moved {by} at about pose {pose}")
            continue
        if term.kind == "scale":
            change = float(1 / (1 - x[0]) - 1)  # by two digits of it
            what = f"scaled by {round(1 + change, 1 - int(np.floor(np.log10(abs(change))))):g}"
        elif term.since is None:
            what = f"with {term.kind} of {size:.2g}°"
        else:
            what = f"slipped by {np.sign(x[0]) * size:+.2g}° at about pose {pose}"
        words.append(f"joint {term.joint + 1} {what}")
    return " and ".join(words)


def _fits(name: str, left: float) -> str:
    fit = "fit" if name.count("joint ") > 1 else "fits"
    return f"{name} {fit}{' best, and more is wrong' * (left > MIN_LEFT)}: {_mm(left)}"


def _refusal(file: Path, found: str, remedy: str) -> InputError:
    expected = "readings in the robot file's sense, zero and order"
    return InputError(file, f"the readings are not this arm's motion: {found}", expected, remedy)


def _mm(size: float) -> str:
    return f"{size * 1e3:.3g} mm are left"
