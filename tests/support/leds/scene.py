"""Truth: cv2.projectPoints of LEDs whose names are known, amid clutter."""

import itertools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from tests.support.scene import project
from verify.core.fiducials import Marker
from verify.core.records import Array, Noise, Spots
from verify.core.rig import Camera, Rig
from verify.measurement.correspondence.assign import Correspondence, PosePrediction, assign_leds

SIZE = (1280, 720)
BARREL = np.array([-0.09, 0.06, 6e-4, -4e-4, 0.0])
PANS = (0.11, -0.09)
NOISE_PX = 0.05
BLUR_PX = 8.0  # nearer to an LED than this no clutter would be seen as a spot of its own
GREY = (200.0, 200.0, 200.0)


LAMPS_LOW, LAMPS_HIGH = [-0.4, -0.3, 0.5], [0.4, 0.3, 1.8]


@dataclass
class Scene:
    rig: Rig
    marker: Marker
    rig_T_flange: Array
    spots: tuple[Spots, Spots]
    spot_of_led: tuple[NDArray[np.int64], NDArray[np.int64]]  # -1 for missing

    def identify(
        self,
        prediction: PosePrediction | None = None,
        expected: tuple[Array, ...] = (),
        skew: float = 2.0,
    ) -> Correspondence:
        return assign_leds(
            self.spots,
            self.rig,
            PANS,
            self.marker,
            prediction=prediction,
            expected=lambda: expected,
            motion_tolerance_px=skew,
        )

    def outcome(self, found: Correspondence) -> str:
        """complete, partial, wrong, or the status of what was not identified."""
        if found.status != "measured":
            return found.status
        left, right = self.spot_of_led
        wrong = np.any(left[found.left_led] != found.left_spot)
        if wrong or np.any(right[found.right_led] != found.right_spot):
            return "wrong"
        whole = (
            len(found.left_led) == (left >= 0).sum() and len(found.right_led) == (right >= 0).sum()
        )
        return "complete" if whole else "partial"


def make_rig(rng: np.random.Generator) -> Rig:
    def camera(x: float) -> Camera:
        focal = rng.uniform(850, 1300)
        matrix = np.array([[focal, 0, rng.normal(640, 5)], [0, focal * 1.002, 358.0], [0, 0, 1]])
        mount = np.eye(4)
        mount[:3, :3] = Rotation.from_rotvec(rng.normal(0, 0.02, 3)).as_matrix()
        mount[:3, 3] = rng.normal(0, 0.005, 3)
        axis, center = np.array([0.0, 1, 0]), np.array([x, 0.0, 0.0])
        return Camera(matrix, BARREL * rng.uniform(0, 1), center, axis, rng.normal(0, 0.01), mount)

    half = rng.uniform(0.06, 0.1)
    return Rig(SIZE, camera(-half), camera(half), np.eye(4))


def make_marker(leds: Array, colours: tuple[str | None, ...] | None = None) -> Marker:
    return Marker(tuple("ABCDEF"[: len(leds)]), leds, colours or (None,) * len(leds), 0.005)


def random_leds(rng: np.random.Generator, count: int, asymmetry: float = 0.0) -> Array:
    while True:
        leds = rng.uniform(-0.07, 0.07, (count, 3))
        apart = np.linalg.norm(leds[:, None] - leds, axis=-1) + np.eye(count)
        if apart.min() > 0.025 and triangle_difference(leds) > asymmetry:
            return leds


def triangle_difference(leds: Array) -> float:
    """How alike the two most alike triangles of LEDs are: largest difference of a side, m."""
    separation = np.linalg.norm(leds[:, None] - leds, axis=-1)
    corner = np.array(list(itertools.permutations(range(len(leds)), 3)))
    sides = np.stack([separation[corner[:, i], corner[:, j]] for i, j in ((0, 1), (0, 2), (1, 2))])
    difference = np.abs(sides[:, :, None] - sides[:, None]).max(axis=0)
    return float(np.min(difference + np.eye(len(corner))))


def random_pose(rng: np.random.Generator) -> Array:
    pose = np.eye(4)
    pose[:3, :3] = Rotation.random(random_state=int(rng.integers(2**31))).as_matrix()
    pose[:3, 3] = rng.uniform([-0.1, -0.08, 0.5], [0.1, 0.08, 0.85])
    return pose


def moved(pose: Array, shift: Array, turn: Array) -> Array:
    out = pose.copy()
    out[:3, :3] = Rotation.from_rotvec(turn).as_matrix() @ pose[:3, :3]
    out[:3, 3] += shift
    return out


def make_spots(
    centre: Array, colour: Array, merged: NDArray[np.bool_] | None = None, sigma: float = NOISE_PX
) -> Spots:
    n = len(centre)
    return Spots(
        centre=centre,
        covariance=np.tile(sigma**2 * np.eye(2), (n, 1, 1)),
        peak=np.full(n, 200.0),
        diameter=np.full(n, 6.0),
        misfit=np.ones(n),
        saturated=np.zeros(n, dtype=bool),
        merged=np.zeros(n, dtype=bool) if merged is None else merged,
        colour=colour,
        noise=Noise(1.5, 0.03, 0.0),
    )


def make_scene(
    rng: np.random.Generator,
    leds: Array,
    *,
    clutter: int = 0,
    lamps: int = 0,
    skew_px: float = 0.0,
    missing: tuple[tuple[int, ...], tuple[int, ...]] = ((), ()),
    colours: tuple[tuple[float, float, float], ...] | None = None,
    names: tuple[str | None, ...] | None = None,
) -> Scene:
    """LEDs, `clutter` spots in each image at random, and `lamps` that both cameras see."""
    rig, pose = make_rig(rng), random_pose(rng)
    direction = rng.normal(size=3)
    metres = skew_px * pose[2, 3] / 1000.0
    shift = metres * direction / np.linalg.norm(direction)
    later = moved(pose, shift, rng.normal(size=3) * metres * 4)  # rad/m: arms of 15 to 50 cm
    light = np.array(colours or [GREY] * len(leds))
    lamp = rng.uniform(LAMPS_LOW, LAMPS_HIGH, (lamps, 3))
    both: list[Spots] = []
    where: list[NDArray[np.int64]] = []
    for side, (camera, flange) in enumerate(((rig.left, pose), (rig.right, later))):
        lit = [led for led in range(len(leds)) if led not in missing[side]]
        points = np.concatenate([(leds @ flange[:3, :3].T + flange[:3, 3])[lit], lamp])
        pixels = project(camera, PANS[side], points) if len(points) else np.zeros((0, 2))
        pixels = np.concatenate([pixels, rng.uniform([0, 0], SIZE, (clutter, 2))])
        gap = np.linalg.norm(pixels[len(lit) :, None] - pixels[: len(lit)], axis=-1)
        apart = np.all(gap > BLUR_PX, axis=1)
        pixels = pixels[np.concatenate([np.full(len(lit), True), apart])]
        pixels += rng.normal(0, NOISE_PX, pixels.shape)
        tint = np.concatenate([light[lit], np.full((len(pixels) - len(lit), 3), GREY)])
        order = rng.permutation(len(pixels))
        both.append(make_spots(pixels[order], tint[order]))
        spot = np.full(len(leds), -1, dtype=np.int64)
        spot[lit] = np.argsort(order)[: len(lit)]
        where.append(spot)
    return Scene(rig, make_marker(leds, names), pose, (both[0], both[1]), (where[0], where[1]))


def near(pose: Array, rng: np.random.Generator, metres: float, radians: float) -> Array:
    """A pose this far off in a random direction."""
    shift, turn = rng.normal(size=3), rng.normal(size=3)
    shift, turn = shift / np.linalg.norm(shift), turn / np.linalg.norm(turn)
    return moved(pose, metres * shift, radians * turn)


def hide(rng: np.random.Generator, count: int) -> tuple[tuple[int, ...], tuple[int, ...]]:
    """Hide LEDs from either camera so that three at least stay visible in both."""
    lost = rng.permutation(count)[: count - 3]
    sides = [tuple(int(led) for led in lost if rng.random() < 0.4) for _ in range(2)]
    return sides[0], sides[1]


EQUILATERAL = 0.05 * np.array([[1.0, 0, 0], [-0.5, 0.75**0.5, 0], [-0.5, -(0.75**0.5), 0]])
ROW = np.array([[-0.06, 0, 0], [0.01, 0, 0], [0.05, 0, 0]])
TWO = np.array([[0.04, 0.01, 0.02], [-0.04, 0.0, 0.01]])


RED, GREEN, BLUE = (20.0, 30.0, 220.0), (60.0, 210.0, 40.0), (230.0, 90.0, 30.0)
