"""Pictures without a solution are refused in one line that names the remedy."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.support.boards.made_views import (
    BOARD,
    SIZE,
    fixed_rig,
    half_turned,
    make_pairs,
    poses,
    turning_rig,
)
from tests.support.recorded import refusal
from verify.calibration.stereo.calibrate import calibrate
from verify.calibration.stereo.refusals import refuse_wrong_readings
from verify.core.fiducials import Board, BoardPair, BoardView
from verify.core.records import Array
from verify.errors import InputError


def good_pairs(count: int = 10, seed: int = 21) -> list[BoardPair]:
    rng = np.random.default_rng(seed)
    return make_pairs(fixed_rig(), poses(rng, count), rng)


@pytest.mark.parametrize(
    ("place", "blind"), [("pairs", ("left", "right")), ("left", ("left",)), ("right", ("right",))]
)
def test_no_board_in_a_camera(place: str, blind: Sequence[str]) -> None:
    pairs = [replace(p, **dict.fromkeys(blind)) for p in good_pairs(4)]
    error = refusal(calibrate, pairs, BOARD, SIZE)
    assert error.place == place
    assert "no board in any of 4" in str(error)


def test_fewer_than_three_pairs_in_which_both_cameras_see_the_board() -> None:
    pairs = good_pairs(6)
    pairs[2:] = [replace(p, right=None) for p in pairs[2:]]
    error = refusal(calibrate, pairs, BOARD, SIZE)
    assert error.place == "pairs"
    assert "in both cameras 2 times" in str(error)


def parallel(tilt_deg: tuple[float, float], distances: Sequence[float]) -> Array:
    """Boards of one tilt, moved about without turning."""
    rng = np.random.default_rng(22)
    boards = np.tile(np.eye(4), (12, 1, 1))
    centre = np.array([(BOARD.columns - 1) / 2, (BOARD.rows - 1) / 2, 0.0]) * BOARD.square
    for i, pose in enumerate(boards):
        wobble = np.array(tilt_deg) + rng.normal(0, 0.2, 2)  # nobody holds a board still
        pose[:3, :3] = Rotation.from_euler("yx", np.deg2rad(wobble)).as_matrix()
        z = distances[i % len(distances)]
        middle = np.array([*(rng.uniform(-0.2, 0.2, 2) * [1.0, 0.6]), 1.0]) * z
        pose[:3, 3] = middle - pose[:3, :3] @ centre
    return boards


@pytest.mark.parametrize(
    ("toe_in_deg", "distances"),
    [
        (0.0, (1.0,)),
        (7.5, (1.0,)),
        (7.5, (0.8, 1.0, 1.2)),
        pytest.param(0.0, (0.8, 1.0, 1.2), marks=pytest.mark.long),
    ],
)
def test_boards_that_all_face_the_cameras_leave_the_focal_length_open(
    toe_in_deg: float, distances: Sequence[float]
) -> None:
    rng = np.random.default_rng(23)
    pairs = make_pairs(fixed_rig(toe_in_deg), parallel((0.0, 0.0), distances), rng)
    error = refusal(calibrate, pairs, BOARD, SIZE)
    assert error.place in ("left", "right")
    assert "focal length" in error.found
    assert "parallel" in error.found
    assert "tilted" in error.remedy


def test_parallel_boards_that_are_tilted_show_the_focal_length_poorly_and_say_so() -> None:
    rng, rig = np.random.default_rng(24), fixed_rig(0.0)
    found = calibrate(make_pairs(rig, parallel((25.0, 15.0), (0.8, 1.0, 1.2)), rng), BOARD, SIZE)
    covariance = found.rig.covariance
    u = covariance.standard_uncertainty[covariance.parameters.index("left.fx_px")]
    assert 4 < u < 10  # px
    assert found.rig.left.matrix[0, 0] == pytest.approx(rig.left.matrix[0, 0], abs=2.5 * u)


def test_few_tilted_boards_show_the_focal_length_to_2_percent_and_its_uncertainty_holds() -> None:
    z, rig = [], fixed_rig()
    for seed in range(10):
        rng = np.random.default_rng(200 + seed)
        found = calibrate(make_pairs(rig, poses(rng, 5), rng, sigma=1.5), BOARD, SIZE)
        covariance = found.rig.covariance
        u = covariance.standard_uncertainty[covariance.parameters.index("left.fx_px")]
        assert 0.005 < u / rig.left.matrix[0, 0] < 0.05
        z.append((found.rig.left.matrix[0, 0] - rig.left.matrix[0, 0]) / u)
    assert 0.5 < np.sqrt(np.mean(np.square(z))) < 1.5  # ten: ± 0.22 is one sigma


def test_boards_at_one_distance_do_where_their_tilts_are_many() -> None:
    rng = np.random.default_rng(25)
    found = calibrate(make_pairs(fixed_rig(), poses(rng, 12, (1.0, 1.0001)), rng), BOARD, SIZE)
    assert found.rig.left.matrix[0, 0] == pytest.approx(1014.4, abs=1.0)


TEN, TWELVE = good_pairs(10), good_pairs(12)
SWAPPED = [
    replace(p, left=p.right, right=p.left, pan_left=p.pan_right, pan_right=p.pan_left) for p in TEN
]
HALF_TURNED = [replace(p, right=half_turned(p.right)) for p in TEN]
OUT_OF_STEP = [replace(p, right=TWELVE[(5 * i + 3) % 12].right) for i, p in enumerate(TWELVE)]


@pytest.mark.parametrize(
    ("pairs", "place", "found", "remedy"),
    [
        (SWAPPED, "left", "cm to its left", "Swap"),
        (HALF_TURNED, "right", "and 2 more", ""),
        (OUT_OF_STEP, "pairs", "do not agree how the cameras stand", ""),
    ],
    ids=["swapped", "half turned throughout", "out of step"],
)
def test_pairs_that_contradict_each_other(
    pairs: list[BoardPair], place: str, found: str, remedy: str
) -> None:
    error = refusal(calibrate, pairs, BOARD, SIZE)
    assert error.place == place
    assert found in error.found
    assert remedy in error.remedy


@pytest.mark.parametrize("kind", ["fixed", "turning"])
@pytest.mark.parametrize("side", ["left", "right"])
def test_a_board_turned_by_180_degrees_in_one_camera_names_the_pairs(kind: str, side: str) -> None:
    rng = np.random.default_rng(26)
    pan = np.deg2rad(rng.uniform(-12, 12, (10, 2))) if kind == "turning" else None
    rig = turning_rig() if kind == "turning" else fixed_rig()
    pairs = make_pairs(rig, poses(rng, 10), rng, pan)
    for i in (2, 7):
        pairs[i] = replace(pairs[i], **{side: half_turned(getattr(pairs[i], side))})
    error = refusal(calibrate, pairs, BOARD, SIZE)
    assert error.place == side
    assert "turned by 180° in pairs 2, 7" in error.found


def test_three_pairs_are_enough_and_a_board_turned_in_both_pictures_is_one_more() -> None:
    assert calibrate(good_pairs(3), BOARD, SIZE).noise == pytest.approx(1.0, abs=0.2)
    pairs = good_pairs()
    pairs[1] = replace(pairs[1], left=half_turned(pairs[1].left), right=half_turned(pairs[1].right))
    assert calibrate(pairs, BOARD, SIZE).noise == pytest.approx(1.0, abs=0.05)


def test_a_pair_of_two_instants_is_left_out_and_named() -> None:
    pairs = good_pairs(12)
    pairs[6] = replace(pairs[6], right=pairs[9].right)
    found = calibrate(pairs, BOARD, SIZE)
    assert 6 not in found.frames
    assert any(d.startswith("pair 6 left out") for d in found.decisions)


def test_the_same_pictures_again_are_left_out_and_named() -> None:
    pairs = good_pairs(5)
    again = [replace(pairs[4], frame=5 + i) for i in range(3)]
    found = calibrate([*pairs, *again], BOARD, SIZE)
    assert found.frames.tolist() == [0, 1, 2, 3, 4]
    assert any(d.startswith("pairs 5, 6, 7 left out: the same pictures") for d in found.decisions)


def test_one_pair_many_times_is_refused_by_that_name() -> None:
    pairs = [replace(good_pairs(1)[0], frame=i) for i in range(5)]
    error = refusal(calibrate, pairs, BOARD, SIZE)
    assert "in both cameras 1 time" in error.found
    assert "pairs 1, 2, 3, 4 left out: the same pictures" in error.remedy


def test_many_pictures_of_a_board_at_one_place_are_refused() -> None:
    rng = np.random.default_rng(29)
    pairs = make_pairs(fixed_rig(), np.repeat(poses(rng, 1), 12, axis=0), rng)
    error = refusal(calibrate, pairs, BOARD, SIZE)
    assert error.place == "pairs"
    assert "one and the same place" in error.found


@pytest.mark.parametrize("mistake", ["columns exchanged", "a row late"])
def test_pan_angles_of_the_other_base_or_of_the_next_pair_are_refused(mistake: str) -> None:
    rng = np.random.default_rng(31)
    turns = np.stack([np.arange(12) % 3 * 12.5 - 5.0, np.arange(12) // 3 % 4 * 8.0 - 20.0], axis=1)
    pan = np.deg2rad(turns)
    wrong = pan[:, ::-1] if mistake == "columns exchanged" else np.roll(pan, 1, axis=0)
    pairs = [
        replace(p, pan_left=left, pan_right=right)
        for p, (left, right) in zip(
            make_pairs(turning_rig(), poses(rng, 12), rng, pan), wrong, strict=True
        )
    ]
    error = refusal(calibrate, pairs, BOARD, SIZE)
    assert error.place == "pairs"
    assert "pan" in error.remedy


def test_a_view_that_shows_no_board_is_left_out_and_named() -> None:
    pairs = good_pairs(10)
    seen = pairs[3].left
    pairs[3] = replace(pairs[3], left=replace(seen, centre=np.roll(seen.centre, 1, axis=0)))
    found = calibrate(pairs, BOARD, SIZE)
    assert any(d.startswith("left camera: pair 3 left out") for d in found.decisions)
    assert found.noise == pytest.approx(1.0, abs=0.05)


SQUARE = Board(columns=8, rows=8, square=0.03)


def quarter_turned(view: BoardView | None) -> BoardView:
    """Number the corners of the square board from the next one, by the pattern's symmetry."""
    y, x = np.divmod(view.corner, 8)
    order = np.argsort(8 * x + 7 - y)
    return BoardView((8 * x + 7 - y)[order], view.centre[order], view.covariance[order])


def square_pairs(turned_ones: Sequence[int]) -> list[BoardPair]:
    rng = np.random.default_rng(27)
    pairs = make_pairs(fixed_rig(), poses(rng, 12), rng, board=SQUARE)
    return [
        replace(p, right=quarter_turned(p.right)) if p.frame in turned_ones else p for p in pairs
    ]


def test_a_square_board_turned_by_90_degrees_in_one_camera_is_left_out_and_named() -> None:
    assert SQUARE.four_fold
    found = calibrate(square_pairs([2, 7]), SQUARE, SIZE)
    assert not {2, 7} & set(found.frames.tolist())
    message = next(d for d in found.decisions if "quarter turn" in d)
    assert message.startswith("pairs 2, 7 left out")
    assert found.noise == pytest.approx(1.0, abs=0.05)
    plain = calibrate(square_pairs([]), SQUARE, SIZE)
    assert len(plain.frames) == 12
    assert not any("quarter turn" in d for d in plain.decisions)


def test_a_square_board_turned_in_one_camera_throughout_is_refused_with_the_reason() -> None:
    with pytest.raises(InputError, match="does not tell a quarter turn"):
        calibrate(square_pairs(range(12)), SQUARE, SIZE)


def test_scaled_pan_readings_are_no_scatter() -> None:
    rng = np.random.default_rng(8)
    pan = np.deg2rad(rng.uniform(-12.0, 12.0, (20, 2)))
    made = make_pairs(turning_rig(), poses(rng, 20), rng, pan)
    scaled = [replace(pair, pan_left=1.1 * pair.pan_left) for pair in made]
    with pytest.raises(InputError, match="pan_left_deg grows faster than its base turns"):
        calibrate(scaled, BOARD, SIZE)
    refuse_wrong_readings(0.01, pan, np.deg2rad(rng.normal(0.0, 0.5, (20, 2))))


@pytest.mark.parametrize(("sides", "factor"), [(("right",), 1.005), (("left", "right"), 1.01)])
def test_a_lens_that_focuses_anew_halfway_is_refused(sides: Sequence[str], factor: float) -> None:
    rig, boards = fixed_rig(), poses(np.random.default_rng(4), 20)
    other = rig
    for side in sides:
        matrix = getattr(rig, side).matrix * np.array([[factor, 1, 1], [1, factor, 1], [1, 1, 1]])
        other = replace(other, **{side: replace(getattr(rig, side), matrix=matrix)})
    before, after = (make_pairs(one, boards, np.random.default_rng(5)) for one in (rig, other))
    error = refusal(calibrate, [*before[:10], *after[10:]], BOARD, SIZE)
    assert error.found.startswith("from about pair 10 on")
    assert "autofocus" in error.remedy


@pytest.mark.parametrize("seed", range(3))
def test_a_board_that_moves_in_the_hand_is_no_change_of_the_rig(seed: int) -> None:
    rng = np.random.default_rng(seed)
    boards = poses(rng, 14)
    shifted = boards.copy()
    shifted[:, :3, 3] += rng.normal(0, 1e-3, (14, 3))
    lefts, rights = (make_pairs(fixed_rig(), seen, rng) for seen in (boards, shifted))
    pairs = [replace(a, right=b.right) for a, b in zip(lefts, rights, strict=True)]
    assert calibrate(pairs, BOARD, SIZE).motion is not None
