"""Results of interim checks."""

from dataclasses import replace

from reports.results import Results
from tests.support.boards.fixture import BOARD, STATED, board_pairs, doubtful_rig
from tests.support.moved_rig import bumped, seen_by
from tests.support.scene import make_rig
from verify.calibration.check.check import check_board, check_rig
from verify.calibration.check.results import check_results
from verify.calibration.origin import ResultsOrigin


def held() -> Results:
    rig = doubtful_rig()
    return check_results(
        check_rig(seen_by((rig, STATED), (rig, STATED), 0), rig, STATED), ResultsOrigin("a")
    )


def not_held() -> Results:
    rig, true = doubtful_rig(), bumped(make_rig())["yaw"]
    found = check_rig(seen_by((true, STATED), (rig, STATED), 1), rig, STATED)
    return check_results(found, ResultsOrigin("b", inputs={"rig.toml": "sha256:" + "0" * 64}))


def board() -> Results:
    rig, known = doubtful_rig(), replace(BOARD, square_standard_uncertainty=5e-6)
    return check_results(check_board(rig, board_pairs(rig), known))
