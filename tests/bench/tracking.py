"""Tracking a coloured object: its cost beside full-frame CamShift's, and errors in hard scenes.

python -m tests.bench.tracking [SCENES]     of each kind
"""

import sys
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from time import thread_time
from typing import Any, TypeVar

import cv2
import numpy as np

from tests.bench.goals import Figure, Line
from tests.bench.grasping import ENDS
from tests.support.grasp.caps import BLUE, GREEN, RED, YELLOW, Cap, Path, Slab, pairs, small_rig
from tests.support.scene import make_rig, project
from verify.core.records import Array, Image, StereoPair
from verify.core.rig import Rig
from verify.grasping.actuators.protocols import ExecutePermission
from verify.grasping.control.aim import LoopCycle
from verify.grasping.control.run import run
from verify.grasping.tracking.camshift import camshift, find_blobs
from verify.grasping.tracking.selection import model_from_box
from verify.grasping.tracking.target import BoxSelection, ColourSelection, TrackingOptions
from verify.grasping.tracking.track import TargetTracker
from verify.measurement.chain import warm_up
from verify.simulation.cell.grab import CellMode, cell_grab
from verify.simulation.cell.scene import draw_scene
from verify.simulation.cell.setup import FULL_SIZE, cell_setup

SECONDS = 1.0  # of film for the rate
ROUNDS = 5  # of which the best counts, picture by picture
MOST_TRACKED, MOST_FOUND_AGAIN = 0.15, 0.4  # of full-frame CamShift's time for one picture
SCENES = 5  # of each kind; docs/tracking.md gives the figures of 40
WRONG = 0.04  # m: `tracked`, but a cap's width from the target or more, or nearer to another
GRIP = 0.003  # m
PERIOD = 1 / 30  # s, from one pair of pictures to the next
Result = TypeVar("Result")
STOP = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 12, 1.0)


def lines(scenes: int = SCENES) -> Iterator[Line]:
    """One line a figure."""
    with one_core():
        yield from rate()
        yield from whole_loop()
    for name, make in SCENARIOS.items():
        yield robustness(name, make, scenes)


@contextmanager
def one_core() -> Iterator[None]:
    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        yield
    finally:
        cv2.setNumThreads(threads)


def rate() -> Iterator[Line]:
    """Pictures of 1280 x 720: one alone, and a pair to the 3D target."""
    path: Path = lambda t: (0.1 * np.sin(2 * t), 0.02, 0.7 + 0.05 * np.cos(2 * t))  # noqa: E731
    rig, caps = make_rig(), [Cap(BLUE, path), Cap(GREEN, lambda _t: (-0.1, 0, 0.8))]
    film = list(pairs(caps, rig, SECONDS))
    rounds = [_track_film(rig, film) for _ in range(ROUNDS)]
    stereo, both, tracked, again, one = np.min(rounds, axis=0).T
    for name, spent, most in (
        ("one picture, tracked", tracked, MOST_TRACKED),
        ("one picture, found again", again, MOST_FOUND_AGAIN),
    ):
        yield compared(name, spent, one, np.median, most)
    for figure in (np.median, np.mean, np.max):
        yield compared(f"pair to 3D target, {figure.__name__}", stereo, both, figure)


def compared(
    name: str,
    ours: Array,
    theirs: Array,
    figure: Callable[[Array], float],
    most: float | None = None,
) -> Figure:
    """Our seconds over full-frame CamShift's."""
    mine, other = float(figure(ours)), float(figure(theirs))
    note = f"{1e3 * mine:.2f} ms, full-frame CamShift {1e3 * other:.2f} ms"
    return Figure(name, mine / other, most=most, note=note)


def _track_film(rig: Rig, film: list[StereoPair]) -> list[tuple[float, ...]]:
    """Track a film: s of each pair in which the target is tracked.

    The pair, by us and by CamShift on both pictures; its left picture alone, where it is predicted,
    where it is not, and by CamShift.
    """
    tracker = TargetTracker(rig, ColourSelection("blue"), TrackingOptions())
    naive, before, model, rows = _FullFrame(), None, None, []
    for pair in film:
        took, now = timed(tracker.step, pair)
        one, other = naive.search(0, pair.left), naive.search(1, pair.right)
        if before is not None and model is not None and now.windows[0] is not None:
            known = now.windows[0], model, before.extent
            tracked, _ = timed(camshift, pair.left, before.box, *known)
            again, _ = timed(find_blobs, pair.left, model)
            rows.append((took, one + other, tracked, again, one))
        before = now.left
        if before is not None and model is None:
            model = model_from_box(pair.left, before.box)
    return rows


def timed(what: Callable[..., Result], *arguments: Any) -> tuple[float, Result]:
    """Call a function: the seconds of the processor that it takes, and what it returns."""
    began = thread_time()
    result = what(*arguments)
    return thread_time() - began, result


def whole_loop() -> Iterator[Line]:
    """Two pictures of 1280 x 720 to the joints' command, from search to lift.

    The hand's LEDs are not measured: a station does that on a thread of its own.
    """
    warm_up()
    permission, mode = ExecutePermission("bench"), CellMode(auto=True, closed=False)
    grab = cell_grab(cell_setup(FULL_SIZE), draw_scene(0), permission=permission, mode=mode)
    ours: list[float] = []
    theirs: list[float] = []
    naive = _FullFrame()

    cycle = grab.loop.cycle

    def timed_cycle(pair: StereoPair | None) -> LoopCycle:
        took, now = timed(cycle, pair)
        if pair is not None:
            theirs.append(naive.search(0, pair.left) + naive.search(1, pair.right))
            ours.append(took)
        return now

    grab.loop.cycle = timed_cycle  # type: ignore[method-assign]
    state = run(grab.loop, grab.source, ENDS, lambda _: None).state.value
    for figure in (np.median, np.mean):
        name = f"pair to joint command, {figure.__name__}"
        yield compared(name, np.array(ours), np.array(theirs), figure)
    within = float(np.mean(np.array(ours) < PERIOD))
    yield f"  {within:.1%} of {len(ours)} cycles within a picture's time; it ended {state}"


class _FullFrame:
    """CamShift on the back projection of whole pictures, as in the usual demonstration."""

    def __init__(self) -> None:
        self.windows: list[Any] = [None, None]  # of the left and the right picture
        self.histogram = np.zeros((30, 8), dtype=np.float32)
        self.histogram[17:22, 3:] = 255.0  # blue

    def search(self, side: int, image: Image) -> float:
        """Track in one picture, 0 the left one; the seconds of the processor that it takes."""
        begin = thread_time()
        hsv = cv2.cvtColor(image, cv2.COLOR_BGR2HSV)
        weights = cv2.calcBackProject([hsv], [0, 1], self.histogram, [0, 180, 0, 256], 1.0)
        weights[hsv[..., 2] < 25] = 0
        window = self.windows[side] or (0, 0, image.shape[1], image.shape[0])
        self.windows[side] = tuple(cv2.CamShift(weights, window, STOP)[1])
        return thread_time() - begin


@dataclass(frozen=True)
class Scene:
    things: list[Cap | Slab]  # the target first
    seconds: float = 3.5
    light: Callable[[float], float] = lambda _t: 1.0


def robustness(name: str, make: Callable[[np.random.Generator], Scene], scenes: int) -> str:
    """Film scenes drawn at random; count what went wrong."""
    rig, counts, errors, worst = small_rig(), Counter[str](), [], 0.0
    for number in range(scenes):
        scene = make(np.random.default_rng(number))
        wrong, last, offs = _film(scene, rig, number)
        counts["wrong"] += wrong
        counts["tracked at the end"] += last == "tracked"
        errors += offs
        worst = max(worst, *offs)
    rms = 1e3 * float(np.sqrt(np.mean(np.square(errors))))
    within = 100 * float(np.mean(np.array(errors) < GRIP))
    return (
        f"{name}: {scenes} scenes, another object taken for it in {counts['wrong']}, "
        f"tracked at the end in {counts['tracked at the end']}; error {rms:.1f} mm rms, "
        f"{within:.1f} % within 3 mm, worst {1e3 * worst:.0f} mm"
    )


def _film(scene: Scene, rig: Rig, seed: int) -> tuple[bool, str, list[float]]:
    """Track one scene: whether it was wrong, the last status, and errors where tracked, m."""
    wrong, status, offs = False, "", []
    tracker: TargetTracker | None = None
    target = scene.things[0]
    for pair in pairs(scene.things, rig, scene.seconds, light=scene.light, seed=seed):
        if tracker is None:
            tracker = TargetTracker(rig, drawn_around(target, rig, pair), TrackingOptions())
        found = tracker.step(pair)
        status = found.status
        if status == "tracked":
            places = [thing.path(pair.t_left) for thing in scene.things]
            away = [float(np.linalg.norm(found.centre - np.array(place))) for place in places]
            offs.append(away[0])
            wrong = wrong or away[0] > WRONG or away[0] > min(away)
    return wrong, status, offs


def drawn_around(target: Cap | Slab, rig: Rig, pair: StereoPair) -> BoxSelection:
    """Draw a box around the target in the left picture, as a person would."""
    place = np.array(target.path(pair.t_left), dtype=float)
    x, y = project(rig.left, pair.pan_left, place[None])[0]
    half = 1.1 * 0.02 * rig.left.matrix[0, 0] / place[2]
    return BoxSelection((round(x - half), round(y - half), round(2 * half), round(2 * half)))


def _colour(rng: np.random.Generator) -> tuple[int, int, int]:
    return (BLUE, GREEN, RED, YELLOW)[rng.integers(4)]


def _wander(rng: np.random.Generator, middle: Array, reach: float, pace: float) -> Path:
    """A smooth path about a point; `pace` in rad/s."""
    phase, rate = rng.uniform(0, 2 * np.pi, 3), pace * rng.uniform(0.5, 1.5, 3)
    return lambda t: middle + reach * np.array([1, 0.4, 1]) * np.sin(rate * t + phase)


def _carried(rng: np.random.Generator) -> Scene:
    """Carried about among caps of other colours; the light halves within a second."""
    colour = _colour(rng)
    others = [c for c in (BLUE, GREEN, RED, YELLOW) if c != colour]
    middle = np.array([0.0, 0.03, 0.72])
    things: list[Cap | Slab] = [Cap(colour, _wander(rng, middle, 0.07, 3.0))]
    things += [
        Cap(c, _wander(rng, middle + np.array([dx, 0.02, 0.1]), 0.03, 2.0))
        for c, dx in zip(others, (-0.1, 0.0, 0.1), strict=True)
    ]
    begins = rng.uniform(0.3, 1.5)
    return Scene(things, 3.0, lambda t: 1.0 - 0.5 * float(np.clip(t - begins, 0, 1)))


def _crossing(rng: np.random.Generator) -> Scene:
    """At rest or in motion while another of its colour passes, before it or behind."""
    colour, moving = _colour(rng), rng.random() < 0.5
    middle = np.array([rng.uniform(-0.03, 0.03), 0.03, 0.7])
    pace = rng.uniform(-0.1, 0.1) if moving else 0.0
    other = rng.choice([-1, 1]) * rng.uniform(0.15, 0.3)
    gap = rng.choice([-1, 1]) * rng.uniform(0.05, 0.12)
    low = rng.uniform(-0.005, 0.02) * np.sign(-gap)

    own: Path = lambda t: middle + np.array([pace * (t - 1.5), 0, 0])  # noqa: E731
    passing: Path = lambda t: middle + np.array([other * (t - 1.5), low, gap])  # noqa: E731
    return Scene([Cap(colour, own), Cap(colour, passing)])


def _hidden(rng: np.random.Generator) -> Scene:
    """Hidden by a board for a while, with another of its colour at rest nearby."""
    colour = _colour(rng)
    middle = np.array([rng.uniform(-0.03, 0.03), 0.03, 0.7])
    beside = middle + np.array(
        [rng.choice([-1, 1]) * rng.uniform(0.07, 0.14), 0.0, rng.uniform(-0.05, 0.05)]
    )
    pace = rng.choice([-1, 1]) * rng.uniform(0.2, 0.5)

    board: Path = lambda t: middle + np.array([pace * (t - 1.6), 0.0, -0.2])  # noqa: E731
    caps = [Cap(colour, lambda _t: middle), Cap(colour, lambda _t: beside)]
    return Scene([*caps, Slab(board, 0.06)])


def _leaving(rng: np.random.Generator) -> Scene:
    """Leaves the picture and returns; another of its colour stays."""
    colour, begins = _colour(rng), rng.uniform(0.3, 0.8)
    side, pace = rng.choice([-1, 1]), rng.uniform(0.4, 0.8)
    middle = np.array([0.12 * side, 0.03, 0.7])
    stays = np.array([-0.1 * side, 0.05, 0.72])

    def path(t: float) -> Array:
        far = pace * min(max(t - begins, 0.0), max(begins + 1.6 - t, 0.0))
        return middle + np.array([side * far, 0, 0])

    return Scene([Cap(colour, path), Cap(colour, lambda _t: stays)])


SCENARIOS = {
    "carried, the light halves": _carried,
    "another of its colour passes": _crossing,
    "hidden beside another": _hidden,
    "leaves while another stays": _leaving,
}


if __name__ == "__main__":
    for line in lines(*[int(n) for n in sys.argv[1:2]]):
        print(line, flush=True)
