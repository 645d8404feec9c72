"""Where machine code is kept: never where it could not be written, and never in the way."""

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from tests.support.leds import scene as scenes
from tests.support.scene import facing, make_marker, make_rig, sight
from verify.analysis.session import analyse
from verify.analysis.warm_up import warm_up
from verify.calibration.corners.find import find_board
from verify.compile_ahead import compile_ahead
from verify.core import jit
from verify.core.fiducials import Board
from verify.io.session.session import open_session
from verify.measurement.chain import Setup, measure
from verify.measurement.correspondence.assign import PosePrediction
from verify.measurement.pose import fit_pose

ROOT = Path(__file__).parents[3]
# the package's own folder as of a user who may not write there
REPORT_CACHE = """
import importlib.util, logging, os, pathlib
logging.basicConfig(level=logging.INFO)
may, own = os.access, str(pathlib.Path(importlib.util.find_spec("verify").origin).parent)
os.access = lambda path, mode: str(path) != own and may(path, mode)
from verify.core import jit
from verify.analysis.session import analyse
from verify.core.fiducials import Board
from verify.calibration.corners.find import find_board
from verify.compile_ahead import compile_ahead
from verify.core.kernels.linear_algebra import dot
import numpy as np
print(jit.CACHE, dot(np.array([1.0, 0.0, 0.0]), np.ones(3)))
"""


def cache_report(cache: Path) -> tuple[list[str], bool]:
    """Whether machine code is kept, what was computed; and whether compiling was announced."""
    environment = {k: v for k, v in os.environ.items() if k != "NUMBA_CACHE_DIR"}
    done = subprocess.run(
        [sys.executable, "-c", REPORT_CACHE],
        env=environment | {"XDG_CACHE_HOME": str(cache)},
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    return done.stdout.split(), jit.COMPILING in done.stderr


@pytest.mark.slow
def test_where_the_package_cannot_be_written_the_user_s_cache_serves(tmp_path: Path) -> None:
    assert cache_report(tmp_path) == (["True", "1.0"], True)
    assert list((tmp_path / "verify").rglob("*.nbi"))
    assert cache_report(tmp_path) == (["True", "1.0"], False)


@pytest.mark.slow
def test_what_cannot_be_kept_is_compiled_all_the_same(tmp_path: Path) -> None:
    (tmp_path / "cache").write_text("in the way")
    assert cache_report(tmp_path / "cache") == (["False", "1.0"], False)


def compiled_now() -> dict[str, list[str]]:
    """Every compiled function of the package, with the types that it is in memory for."""
    return {
        f"{module}.{name}": sorted(map(str, thing.signatures))
        for module, own in list(sys.modules.items())
        if module.split(".")[0] == "verify"
        for name, thing in vars(own).items()
        if hasattr(thing, "py_func")
    }


def pairs_of_a_session() -> None:
    session = open_session(ROOT / "sample_sessions" / "quarter_circle_6r")
    pairs = (pair for pair, _ in zip(session.pairs(), range(4), strict=False))
    assert len(list(measure(pairs, Setup(session.rig, session.marker)))) == 4


def spots_of_every_kind() -> None:
    rng = np.random.default_rng(0)
    lit = {"colours": (scenes.RED, scenes.GREEN, scenes.BLUE), "names": ("red", "green", "blue")}
    for scene in (
        scenes.make_scene(rng, scenes.EQUILATERAL, **lit),
        scenes.make_scene(rng, scenes.TWO, lamps=2),
        scenes.make_scene(rng, scenes.ROW, missing=((0,), (0, 1))),
        scenes.make_scene(rng, np.array([[0.03, 0.0, 0.02]]), clutter=2),
    ):
        pose = scenes.near(scene.rig_T_flange, rng, 0.004, 0.04)
        scene.identify()
        scene.identify(PosePrediction(pose, 0.005, 0.05))
        scene.identify(expected=(np.asfortranarray(pose), pose))


def poses_of_every_kind() -> None:
    rig, truth = make_rig(), facing(0.05, -0.03, 0.6)
    for count, off in ((1, 0.0), (2, 0.0), (4, 0.0), (4, 3.0)):
        left, right = sight(rig, make_marker(count), truth, 0.05)
        left.centre[0] += off
        right.lever[:] = 1e-4
        fit_pose(left, right, rig, make_marker(count), np.asfortranarray(truth))


def results_of_a_session() -> None:
    analyse(open_session(ROOT / "sample_sessions" / "quarter_circle_6r"))


def corners_of_a_board() -> None:
    squares = np.indices((6, 9)).sum(axis=0) % 2
    light = np.pad(np.kron(squares, np.ones((30, 30))), 40, constant_values=1.0)
    image = np.asarray(cv2.GaussianBlur(40 + 160 * light, (0, 0), 1.0), np.uint8)
    assert find_board(image, Board(8, 5, 0.02)) is not None


AHEAD = {
    warm_up: (pairs_of_a_session, spots_of_every_kind, poses_of_every_kind),
    compile_ahead: (results_of_a_session, corners_of_a_board),
}


def report_what_is_compiled_after(name: str) -> None:
    """Print what was not in memory after compiling ahead: run in a process of its own."""
    ahead = next(each for each in AHEAD if each.__name__ == name)
    ahead()
    before = compiled_now()
    for use in AHEAD[ahead]:
        use()
        late = {name: types for name, types in compiled_now().items() if before[name] != types}
        print(use.__name__, late or "nothing")


@pytest.mark.slow
@pytest.mark.parametrize("ahead", AHEAD, ids=lambda each: str(each.__name__))
def test_after_compiling_ahead_nothing_is_left_to_compile(ahead: Callable[[], None]) -> None:
    name = f"t.report_what_is_compiled_after({ahead.__name__!r})"
    own = f"import tests.verify.core.test_jit as t; {name}"
    done = subprocess.run(
        [sys.executable, "-c", own], cwd=ROOT, capture_output=True, text=True, check=True
    )
    late = [line.split(maxsplit=1)[1] for line in done.stdout.splitlines()]
    assert late == ["nothing"] * len(AHEAD[ahead])


def test_every_compiled_source_is_in_the_cache_key() -> None:
    package = Path(jit.__file__).parents[1]
    counted = {package / source for source in jit.compiled_sources(package)}
    has_some = {f for f in package.rglob("*.py") if "@compiled" in f.read_text()}
    assert len(has_some) > 10
    assert has_some <= counted
