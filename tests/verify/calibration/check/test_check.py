"""The interim check of healthy and of moved rigs, by LEDs, a bar and a board."""

from dataclasses import replace
from functools import partial

import msgspec
import numpy as np
import pytest
from numpy.testing import assert_allclose

from tests.support.boards.fixture import BOARD, STATED, board_pairs, doubtful_rig
from tests.support.boards.made_views import found_pairs
from tests.support.drawn_rig import believed, drawn
from tests.support.moved_rig import bumped, seen_by, stretched, turned
from tests.support.recorded import require_shared
from tests.support.scene import make_marker, make_rig
from tests.support.simulated import in_memory, sample
from verify.calibration.check.check import (
    CheckResult,
    bar_marker,
    check_board,
    check_rig,
    check_session,
)
from verify.calibration.check.results import check_results
from verify.core.fiducials import Board
from verify.core.records import Measurement
from verify.errors import InputError
from verify.io import rig as io_rig

REPLICATES = 60


@pytest.mark.slow
def test_a_healthy_rig_is_held_and_every_length_is_in_its_uncertainty() -> None:
    rig, marker = believed(doubts=True)
    held, z = 0, []
    for seed in range(REPLICATES):
        true = drawn(rig, marker, np.random.default_rng(seed))
        result = check_rig(seen_by(true, (rig, marker), seed), rig, marker)
        held += result.holds
        each = result.lengths
        z.extend((each.measured - each.known) / each.uncertainty)
    # 95 % for all three figures: three deviations of a binomial of 60
    assert held / REPLICATES > 0.95 - 3 * np.sqrt(0.95 * 0.05 / REPLICATES)
    # six lengths share the rig's error: as if 60 draws; 9 % each way is one deviation
    assert 0.73 < np.sqrt(np.mean(np.square(z))) < 1.27


@pytest.mark.parametrize("what", ["yaw", "pitch", "roll", "baseline"])
def test_a_bumped_rig_is_not_held(what: str) -> None:
    rig = doubtful_rig()
    true = bumped(make_rig())[what]
    result = check_rig(seen_by((true, STATED), (rig, STATED), 1), rig, STATED)
    assert result.verdict == "not_held"
    assert any("beyond" in d for d in result.decisions)


@pytest.mark.parametrize("away", [(0.0, 0.0, 5e-3), (1e-3, 0.0, 0.0)], ids=["5 mm", "1 mm"])
def test_an_led_that_is_not_where_the_marker_file_has_it_is_named(
    away: tuple[float, float, float],
) -> None:
    rig, leds = doubtful_rig(), STATED.leds.copy()
    leds[1] += away
    believed_to_be = rig, replace(STATED, leds=leds)
    result = check_rig(seen_by((make_rig(), STATED), believed_to_be, 3, 24), *believed_to_be)
    assert result.verdict == "not_held"
    text, size = result.decisions[0], 1e3 * float(np.linalg.norm(away))
    assert text.startswith(f"LED {STATED.names[1]} is seen ")
    assert "measure its place again" in text
    assert abs(float(text.split()[4]) - size) < 0.2
    assert check_results(result).summary["displaced_led"] == text
    sound = check_rig(seen_by((make_rig(), STATED), (rig, STATED), 3, 24), rig, STATED)
    assert sound.holds
    assert sound.displaced is None


def test_an_led_that_no_pair_shows_is_named() -> None:
    session = in_memory(sample(pairs=8))
    leds = session.marker.leds.copy()
    leds[0] += np.array([20.0, 20.0, 10.0]) * 1e-3
    result = check_session(replace(session, marker=replace(session.marker, leds=leds)))
    assert any("where marker.toml puts them: LED A." in w for w in result.warnings)
    assert not any("Not detected" in w for w in check_session(session).warnings)


def test_lengths_show_a_baseline_off_by_half_a_percent() -> None:
    rig = make_rig()
    file = stretched(rig, 1.005), STATED
    each = check_rig(seen_by((rig, STATED), file, 1), *file).lengths
    assert_allclose(each.measured / each.known, 1.005, atol=1e-3)
    assert each.ends[0] == ("A", "B")


@pytest.mark.slow
def test_the_stated_detectable_change_is_found_four_times_in_five() -> None:
    rig = doubtful_rig()
    found = check_rig(seen_by((rig, STATED), (rig, STATED), 0), rig, STATED)
    smallest, _ = found.visible["yaw of one camera"]
    assert smallest < 0.05
    seen = 0
    for seed in range(REPLICATES):
        rng = np.random.default_rng(seed)
        true = replace(rig, right=turned(rig.right, 1, smallest + 0.005 * rng.normal()))
        marker = replace(STATED, leds=STATED.leds + rng.normal(0, 2.2e-5, (4, 3)))
        seen += not check_rig(seen_by((true, marker), (rig, STATED), seed), rig, STATED).holds
    # power 80 %; a floor for the spots' shape is granted but not drawn, which shows more
    assert seen / REPLICATES > 0.8 - 3 * np.sqrt(0.8 * 0.2 / REPLICATES)


def test_missing_uncertainties_and_undetectable_changes_are_listed() -> None:
    file = make_rig(), make_marker()
    healthy = check_rig(seen_by(file, file, 0), *file)
    assert healthy.uncounted == ("rig", "LED positions", "apparent LED centre")
    assert any("taken as exact" in w for w in healthy.warnings)
    assert any("both cameras together" in d for d in healthy.decisions)  # what no check shows
    off = check_rig(seen_by((bumped(file[0])["yaw"], file[1]), file, 0), *file)
    assert any("could not be tested" in w for w in off.warnings)
    assert not any("could not be tested" in w for w in healthy.warnings)


def test_a_bar_of_two_leds_brings_its_own_length() -> None:
    two = make_marker(2)
    length = float(np.linalg.norm(two.leds[1] - two.leds[0]))
    rough = replace(two, leds=two.leds * 1.01)  # marker.toml knows it to a percent
    known = bar_marker(rough, length, 1e-5)
    assert_allclose(np.linalg.norm(known.leds[1] - known.leds[0]), length)
    rig = make_rig()
    assert check_rig(seen_by((rig, two), (rig, known), 0), rig, known).holds
    file = stretched(rig, 1.01), known
    off = check_rig(seen_by((rig, two), file, 0), *file)
    assert off.verdict == "not_held"
    assert_allclose(off.found.by_source["LED positions"][0], 1e-5 / length, rtol=0.02)


def test_one_pair_of_a_board_suffices() -> None:
    rig = doubtful_rig()
    board = replace(BOARD, square_standard_uncertainty=5e-6)
    result: CheckResult = check_board(rig, board_pairs(rig), board)
    assert result.holds
    assert result.uncounted == ()
    known, measured, uncertainty = result.square
    assert known == BOARD.square
    assert abs(measured - known) < 3 * uncertainty
    assert uncertainty > 5e-6
    for what, true in bumped(make_rig()).items():
        assert not check_board(rig, board_pairs(true), board).holds, what


def test_a_rig_that_looks_elsewhere_is_refused() -> None:
    rig = make_rig()
    with pytest.raises(InputError, match=r"cannot have taken them.*rig\.toml of these cameras"):
        check_board(replace(rig, left=turned(rig.left, 0, 90.0)), board_pairs(rig, 3), BOARD)


def test_the_board_s_squares_come_out_as_much_too_large_as_the_baseline() -> None:
    rig = make_rig()
    result = check_board(stretched(rig, 1.005), board_pairs(rig, 3), BOARD)
    assert_allclose(result.square[1] / result.square[0], 1.005, atol=2e-4)
    assert result.uncounted == ("rig", "square size")


def test_pictures_that_show_nothing_and_a_bar_of_three_leds_are_refused() -> None:
    blind = [replace(p, left=None) for p in board_pairs(make_rig())]
    with pytest.raises(InputError, match="no pair shows the board in both images"):
        check_board(make_rig(), blind, BOARD)
    with pytest.raises(InputError, match="0 of 0 pairs"):
        check_rig([], make_rig(), make_marker())
    with pytest.raises(InputError, match="the marker has 3 LEDs; a bar of known length has two"):
        bar_marker(make_marker(3), 0.1)


def test_the_few_pairs_that_fit_a_badly_moved_rig_by_chance_hold_nothing() -> None:
    file = make_rig(), STATED
    few = seen_by(file, file, 0)[:2]
    lost = [Measurement(i, float(i), "ambiguous_leds", 4) for i in range(2, 12)]
    with pytest.raises(InputError, match=r"2 of 12 pairs show .* has moved too far"):
        check_rig([*few, *lost], *file)


@pytest.mark.slow
def test_a_session_of_a_symmetric_bar_is_checked() -> None:
    four = sample(pairs=8)
    bar = msgspec.structs.replace(four.marker, led=four.marker.led[:2])
    session = in_memory(msgspec.structs.replace(four, marker=bar))
    length = float(np.linalg.norm(session.marker.leds[1] - session.marker.leds[0]))
    check = partial(check_session, session, length_standard_uncertainty=1e-5)
    output: list[int] = []
    result = check(length=length, progress=lambda done, _: output.append(done))
    assert result.holds
    assert output == list(range(1, 9))
    assert result.lengths.pairs.tolist() == [8]
    assert not check(length=length * 1.004).holds


@pytest.mark.shared
def test_one_ray_traced_board_holds_the_true_rig_and_shows_a_yaw_of_a_twentieth_degree() -> None:
    folder = require_shared() / "calibration_boards"
    rig, _ = io_rig.read(folder / "rig.toml")
    board = Board(columns=9, rows=7, square=0.04)
    yawed = replace(rig, right=turned(rig.right, 1, 0.05))
    left, right = ([folder / s / f"{i:06d}.png" for i in (0, 7, 14)] for s in ("left", "right"))
    for pair in found_pairs(left, right, board, (rig.left.pan, rig.right.pan)):
        assert check_board(rig, [pair], board).holds
        assert not check_board(yawed, [pair], board).holds
