"""Where the robot stands in the rig, from a board at a known place on its base.

Nothing of the robot's own is used, neither encoders nor DH table, so this registration hides no
fault of theirs.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from hashlib import sha256

import numpy as np
from scipy.linalg import block_diag

from robots.transforms import cross_matrix, difference, invert
from verify.calibration.board.pose import board_marker, board_poses, residual_beside
from verify.calibration.registration.uncertainty import BASE_NAMES
from verify.calibration.stereo.calibrate import drop_copies
from verify.calibration.stereo.records import extend_covariance, rms
from verify.core.fiducials import Board, BoardPair, Marker
from verify.core.records import Array, Index, Measurement
from verify.core.rig import Rig
from verify.core.statistics import chi2_isf
from verify.errors import InputError
from verify.io import rig as io_rig
from verify.measurement.pose import perturb
from verify.measurement.systematics import Systematics, sensitivities, stated_systematics

P_FALSE_ALARM = 1e-3  # of pairs being said to disagree where noise alone is at work
# of the corners' residuals, from which their scatter is known to 7 % and counts as it is: never
# letting it fall below 1 overstates the base's covariance by 4 % where corners keep their word
MIN_DEGREES = 100
MIN_NOISE_FACTOR = 0.25  # times what is stated: pictures without any noise would agree with nothing
MAX_NOISE_FACTOR = 10.0  # times what is stated: beyond it an error, of which no mean is rid
MAX_RMS_PX = 2.0  # with it: no board and no lens model is off by as much
MAX_REJECTED_SHARE = 0.25  # of the pairs; more that disagree, and it is not known which are right


@dataclass(frozen=True, slots=True)
class FixtureRegistration:
    """The robot's place in the rig, and what it rests on."""

    rig: Rig  # with rig_T_base, its covariance and the registration's id
    base_covariance: Array  # (6, 6), m and rad, rig axes: corners, pan readings, rig and fixture
    frames: Index  # (n,), pairs that were used
    pair_difference: Array  # (n, 6), m and rad: each pair's board less the common one
    pair_chi2: Array  # (n,), 6 degrees of freedom: that difference in its own uncertainty
    residual_rms_px: float  # distance of the corners from where the pairs' own poses put them
    noise: float  # by what the corners' stated uncertainty was multiplied
    decisions: tuple[str, ...]
    warnings: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class _CommonPose:
    """The board's pose that all pairs share, by generalised least squares."""

    pose: Array  # (4, 4)
    own: Array  # (6, 6), corners and pan readings
    by_rig: Array  # (6, p), d pose / d parameter
    covariance: Array  # (6, 6), with the rig's
    difference: Array  # (n, 6)
    pair_chi2: Array  # (n,)
    chi2: float


def register_fixture(
    rig: Rig,
    pairs: Sequence[BoardPair],
    board: Board,
    base_T_board: Array,
    base_T_board_covariance: Array,
) -> FixtureRegistration:
    """Find the robot's base in the rig by a board fixed to it at base_T_board (4, 4).

    Its covariance (6, 6), m and rad, is of a translation and a small rotation on the left, in base
    axes; all pairs share its error. The board keeps its one place at one or several pan angles. A
    base that the rig may hold is replaced.

    Raises:
        InputError: no usable view of the board, or pairs that put it at different places.
    """
    given = rig.covariance
    if given is not None:  # what an earlier registration added is found anew
        names = enumerate(given.parameters)
        given = given.take([i for i, n in names if n.startswith(("left.", "right."))])
    rig = replace(rig, rig_T_base=np.eye(4), covariance=given)
    pairs, copies = drop_copies(pairs)
    turning = len({(p.pan_left, p.pan_right) for p in pairs}) > 1
    marker = board_marker(board)
    parameters = stated_systematics(rig, marker, turning)
    seen = board_poses(rig, pairs, board, parameters)
    if not seen:
        expected = "at least one picture that shows six of its corners is needed"
        raise InputError("board on the base", "is in no picture", expected, "Turn the cameras.")
    noise = _noise(seen, parameters, rig, marker)
    _refuse_unlike(seen, noise)
    effects = [sensitivities(parameters, m, rig, marker) for m in seen]
    used, common, warnings = _consistent_pairs(seen, effects, parameters, noise)
    base, by_board, by_fixture = _base(common.pose, base_T_board)
    fixture = by_fixture @ base_T_board_covariance @ by_fixture.T
    size = by_board @ _square_effect(rig, pairs, board, common.pose)
    fixture = fixture + np.outer(size, size)
    own = by_board @ common.own @ by_board.T + fixture
    stated = rig.covariance.parameters if rig.covariance else ()
    by_rig = np.zeros((6, len(stated)))  # 0 for names that nobody here understands
    by_rig[:, [stated.index(name) for name in parameters.names]] = common.by_rig
    covariance = extend_covariance(rig.covariance, BASE_NAMES, by_board @ by_rig, own)
    placed = replace(
        rig, rig_T_base=base, base_source="fixture", registration=None, absorption=None,
        covariance=covariance,
    )  # fmt: skip
    placed = replace(placed, registration=f"sha256:{sha256(io_rig.encode(placed)).hexdigest()}")
    left = [m.pose.residual[~m.pose.rejected] for i in used if (m := seen[i]).pose]
    return FixtureRegistration(
        rig=placed,
        base_covariance=by_board @ common.covariance @ by_board.T + fixture,
        frames=np.array([seen[i].frame for i in used], dtype=np.int64),
        pair_difference=common.difference,
        pair_chi2=common.pair_chi2,
        residual_rms_px=rms(np.concatenate(left)),
        noise=noise,
        decisions=_decisions(seen, used, noise, common, fixture),
        warnings=(*copies, *warnings, *_warnings(rig, parameters, base_T_board_covariance, noise)),
    )


def _square_effect(rig: Rig, pairs: Sequence[BoardPair], board: Board, pose: Array) -> Array:
    """What a standard uncertainty of the squares moves the board's pose by, (6,), m and rad."""
    sigma = board.square_standard_uncertainty
    if not sigma:
        return np.zeros(6)
    ends = [
        np.array(
            [
                difference(m.pose.rig_T_flange, pose)
                for m in board_poses(rig, pairs, replace(board, square=board.square + s * sigma))
                if m.pose
            ]
        ).mean(axis=0)
        for s in (0.5, -0.5)
    ]
    moved: Array = ends[0] - ends[1]
    return moved


def _noise(seen: list[Measurement], parameters: Systematics, rig: Rig, marker: Marker) -> float:
    """By what factor corners scatter about their poses more, or less, than they state.

    What the rig's own stated errors bend the pattern by is no scatter of corners, and stands in
    the result already. Where few corners tell, the factor may come out small by chance, and is
    then taken as 1 at least.
    """
    chi2_sum = sum(residual_beside(m, parameters, rig, marker)[1] for m in seen if m.pose)
    degrees = sum(m.pose.degrees_of_freedom for m in seen if m.pose)
    factor = float(np.sqrt(chi2_sum / degrees))
    return max(factor, MIN_NOISE_FACTOR if degrees >= MIN_DEGREES else 1.0)


def _refuse_unlike(seen: list[Measurement], noise: float) -> None:
    """Raise InputError for a pattern that is not where its own pose by this rig puts it."""
    left = rms(np.concatenate([m.pose.residual[~m.pose.rejected] for m in seen if m.pose]))
    if noise > MAX_NOISE_FACTOR and left > MAX_RMS_PX:
        found = f"its corners are {left:.1f} px (rms) from where any place of it would show them"
        remedy = "Check the rig, the square's edge, and the pan angles in frames.csv."
        raise InputError("board on the base", found, f"{MAX_RMS_PX:.0f} px at most", remedy)


def _consistent_pairs(
    seen: list[Measurement], effects: list[Array], parameters: Systematics, noise: float
) -> tuple[list[int], _CommonPose, list[str]]:
    """Pairs that put the board at one place; the few that do not are named and left out."""
    used = list(range(len(seen)))
    warnings: list[str] = []
    while True:
        common = _combine([seen[i] for i in used], [effects[i] for i in used], parameters, noise)
        degrees = 6 * (len(used) - 1)
        if not degrees or common.chi2 < chi2_isf(P_FALSE_ALARM, degrees):
            return used, common, warnings
        worst = int(np.argmax(common.pair_chi2))
        shift, turn = np.linalg.norm(common.difference[worst].reshape(2, 3), axis=1)
        said = (
            f"pair {seen[used[worst]].frame} puts the board {shift * 1e3:.2f} mm and "
            f"{np.rad2deg(turn):.3f}° from where all pairs together put it"
        )
        if len(seen) - len(used) + 1 > MAX_REJECTED_SHARE * len(seen):
            remedy = (
                "See that the board is fixed to the base, and state pan_standard_uncertainty_deg "
                "in rig.toml where the bases were turned."
            )
            raise InputError("board on the base", said, "a fixed board stays in place", remedy)
        warnings.append(f"Left out: {said}, beyond what noise explains.")
        used.pop(worst)


def _combine(
    seen: list[Measurement], effects: list[Array], parameters: Systematics, noise: float
) -> _CommonPose:
    """Generalised least squares on the pairs' poses; rig and pan errors correlate them."""
    poses = [m.pose for m in seen if m.pose]
    centre = poses[0].rig_T_flange
    n = len(poses)
    by_rig = np.concatenate([e[:, : len(parameters.names)] for e in effects])
    varying = np.asarray(block_diag(*[p.covariance_pixels for p in poses]), dtype=float) * noise**2
    varying = varying + _pan(seen, effects, parameters)
    total = varying + by_rig @ parameters.covariance @ by_rig.T
    design = np.tile(np.eye(6), (n, 1))
    weighted = np.linalg.solve(total, design)
    covariance: Array = np.asarray(np.linalg.inv(design.T @ weighted), dtype=np.float64)
    gain = covariance @ weighted.T
    apart = difference(np.array([p.rig_T_flange for p in poses]), centre)
    step = gain @ apart.reshape(-1)
    left = apart.reshape(-1) - design @ step
    spread = total - design @ covariance @ design.T
    # of a single pair nothing is left: its difference is zero, and so is its spread
    by_pair = [
        float(r @ np.linalg.pinv(spread[6 * i : 6 * i + 6, 6 * i : 6 * i + 6], hermitian=True) @ r)
        for i, r in enumerate(left.reshape(n, 6))
    ]
    return _CommonPose(
        pose=perturb(centre, step),
        own=gain @ varying @ gain.T,
        by_rig=gain @ by_rig,
        covariance=covariance,
        difference=left.reshape(n, 6),
        pair_chi2=np.array(by_pair),
        chi2=float(left @ np.linalg.solve(total, left)),
    )


def _pan(seen: list[Measurement], effects: list[Array], parameters: Systematics) -> Array:
    """What the pan readings' errors do, (6 n, 6 n): a reading that is repeated errs alike."""
    total = np.zeros((6 * len(seen), 6 * len(seen)))
    for side in (0, 1):
        if not parameters.pan[side] > 0:
            continue
        views = [m.left if side == 0 else m.right for m in seen]
        reading = np.array([v.pan if v is not None else np.nan for v in views])
        effect = np.concatenate([e[:, len(parameters.names) + side] for e in effects])
        alike = (reading[:, None] == reading).repeat(6, axis=0).repeat(6, axis=1)
        total += alike * np.outer(effect, effect) * parameters.pan[side] ** 2
    return total


def _base(rig_T_board: Array, base_T_board: Array) -> tuple[Array, Array, Array]:
    """rig_T_base, and its derivatives by the board in the rig and by the board on the base."""
    base: Array = rig_T_board @ invert(base_T_board)
    arm = base[:3, 3] - rig_T_board[:3, 3]
    by_board = np.eye(6)
    by_board[:3, 3:] = -cross_matrix(arm)
    by_fixture = np.zeros((6, 6))
    by_fixture[:3, :3] = by_fixture[3:, 3:] = -base[:3, :3]
    by_fixture[:3, 3:] = cross_matrix(arm) @ base[:3, :3]
    return base, by_board, by_fixture


def _decisions(
    seen: list[Measurement], used: list[int], noise: float, common: _CommonPose, fixture: Array
) -> tuple[str, ...]:
    corners = sum(int((~m.pose.rejected).sum()) for m in seen if m.pose)
    rejected = sum(int(m.pose.rejected.sum()) for m in seen if m.pose)
    words = [f"The board's place rests on {corners} corners in {len(used)} of {len(seen)} pairs."]
    if rejected:
        words.append(f"Left out are corners that the others contradict: {rejected}.")
    if noise > 1.05:  # a twentieth is what any finite number of corners scatters by
        words.append(
            f"Corners scatter {noise:.2f} times as much as they state; so much was allowed for."
        )
    if len(used) > 1:
        words.append(
            f"The pairs agree: chi² {common.chi2:.1f} of {6 * (len(used) - 1)} degrees of freedom."
        )
    seen_u, fixed_u = (
        np.sqrt(np.linalg.eigvalsh(c[:3, :3])[-1]) * 1e3 for c in (common.own, fixture)
    )
    words.append(
        f"Of the base's position, corners and pan leave {seen_u:.3f} mm open, the fixture "
        f"{fixed_u:.3f} mm."
    )
    return tuple(words)


def _warnings(rig: Rig, parameters: Systematics, fixture: Array, noise: float) -> Iterator[str]:
    unstated = {
        "rig": rig.covariance is None,
        "pan angle": "pan angle" in parameters.uncounted,
        "fixture": not np.any(fixture),
    }
    if exact := ", ".join(source for source, is_exact in unstated.items() if is_exact):
        yield f"No uncertainty is stated for {exact}: taken as exact."
    if noise > MAX_NOISE_FACTOR:
        yield (
            f"Corners lie {noise:.0f} times as far from where the board's pose puts them as their "
            "noise explains: rig, square or pan angles are off, and the base by more than its U."
        )
