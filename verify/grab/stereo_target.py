"""Two patches of colour, one object: its place in the rig with uncertainty, and its size."""

from dataclasses import dataclass

import numpy as np

from verify.grab.stereo_target_camera import Sight
from verify.records import Array
from verify.rig import Rig
from verify.spot_derivatives import camera_pixels
from verify.systematics import CAMERA_KEYS, unit
from verify.triangulation import meet

# of a patch's extent, standard: by as much its centroid misses the object's middle, differently in
# either picture: reflections, shading, the side a camera sees. It does not average out.
COLOUR_LIES = 0.005
RIM = 1.0  # px by which a patch reaches beyond its object: pixels that show a quarter of it count
EDGE = 1.0  # px, standard, of an extent: whole pixels, and a rim that depends on what is behind
STEPS = 2  # of Gauss-Newton: from the midpoint of the rays the first leaves a millionth


@dataclass(frozen=True, slots=True)
class Place:
    """A point seen by both cameras."""

    point: Array  # (3,), m, rig
    covariance: Array  # (3, 3), m², from the pixels' covariance
    systematic: Array  # (3, 3), m², from what the rig states of itself and from COLOUR_LIES
    mismatch: float  # of the rays, in standard deviations of all that is known
    depth: Array  # (2,), m, along the optical axes, left and right


def rough(left: Sight, right: Sight) -> Array:
    """The point midway between two lines of sight, (3,) m; nan where they do not meet."""
    centres = [sight.placed.rig_T_camera[:3, 3] for sight in (left, right)]
    return meet(centres[0], left.ray, centres[1], right.ray)[0]


def locate(left: Sight, right: Sight, rig: Rig, start: Array) -> Place | None:
    """Find the point of least reprojection error, and what is known of it.

    Args:
        left: what the left camera saw.
        right: what the right camera saw, brought to the same instant.
        rig: whose covariance is carried along where it states one.
        start: (3,), m, from `rough`.

    Returns:
        None where the rays do not meet before both cameras.
    """
    if not np.isfinite(start).all():
        return None
    sights = (left, right)
    noise, lies = np.zeros((4, 4)), np.zeros((4, 4))
    for i, sight in enumerate(sights):
        rows = np.s_[2 * i : 2 * i + 2, 2 * i : 2 * i + 2]
        noise[rows] = sight.covariance
        wander = np.linalg.inv(sight.lens) * (COLOUR_LIES * sight.extent)
        lies[rows] = wander @ wander.T
    weight = np.linalg.inv(noise + lies)
    seen = np.concatenate([left.xy, right.xy])
    point = start
    for _ in range(STEPS):
        inside = [sight.placed.inside(point) for sight in sights]
        slope = np.concatenate([s.placed.slope(p) for s, p in zip(sights, inside, strict=True)])
        left_over = seen - np.concatenate([p[:2] / p[2] for p in inside])
        gain = np.linalg.solve(slope.T @ weight @ slope, slope.T @ weight)
        step = gain @ left_over
        point = point + step
    left_over = left_over - slope @ step
    stated = _stated(sights, point, slope, rig)
    across = np.linalg.svd(slope)[0][:, 3]  # the one direction that no point explains
    spread = float(across @ (noise + lies + stated) @ across)
    return Place(
        point,
        gain @ noise @ gain.T,
        gain @ (lies + stated) @ gain.T,
        abs(float(across @ left_over)) / float(np.sqrt(spread)),
        np.array([p[2] for p in inside]),
    )


def size(left: Sight, right: Sight, place: Place) -> tuple[Array, Array]:
    """Measure an object across the line of sight.

    Returns:
        Width and height (2,), m, along the pictures' rows and columns, the mean of both cameras
        weighted by what each pixel is worth, and their standard uncertainties (2,), m.
    """
    worth = np.array(
        [
            depth / np.diag(sight.lens) / sight.slant
            for sight, depth in zip((left, right), place.depth, strict=True)
        ]
    )
    metres = (np.array([left.extent, right.extent]) - 2 * RIM) * worth
    weight = 1.0 / (worth * EDGE) ** 2
    mean = (metres * weight).sum(axis=0) / weight.sum(axis=0)
    edges = 1.0 / weight.sum(axis=0)
    apart = ((metres[0] - metres[1]) / 2) ** 2  # the two cameras see different sides of it
    far = np.sqrt(np.trace(place.covariance + place.systematic)) / place.depth.mean()
    deep = mean.max() / 2 / place.depth.mean() / np.sqrt(3)  # its outline: nearer than its middle?
    uncertainty: Array = np.sqrt(edges + apart + mean**2 * (far**2 + deep**2))
    return mean, uncertainty


def _stated(sights: tuple[Sight, Sight], point: Array, slope: Array, rig: Rig) -> Array:
    """Covariance of both lines of sight from the rig's own and the pan readings', (4, 4)."""
    total = np.zeros((4, 4))
    given = rig.covariance
    if given is not None:
        names = [n for n in given.parameters if _of_camera(n)]
        chosen = [given.parameters.index(n) for n in names]
        units = np.array([unit(name) for name in names])
        sigma = given.standard_uncertainty[chosen] * units
        moved = np.zeros((4, len(names)))
        for column, name in enumerate(names):
            head, _, key = name.partition(".")
            moved[:, column] = _moved(sights, point, slope, head, key)
        correlation = given.correlation[np.ix_(chosen, chosen)]
        total += moved @ (correlation * np.outer(sigma, sigma)) @ moved.T
    for head, camera in (("left", rig.left), ("right", rig.right)):
        if camera.pan_standard_uncertainty:
            turned = _moved(sights, point, slope, head, "pan_zero_deg")
            total += np.outer(turned, turned) * camera.pan_standard_uncertainty**2
    return total


def _of_camera(name: str) -> bool:
    head, _, key = name.partition(".")
    return head in ("left", "right") and CAMERA_KEYS.match(key) is not None


def _moved(sights: tuple[Sight, Sight], point: Array, slope: Array, head: str, key: str) -> Array:
    """Derivative of both lines of sight by one parameter of one camera, (4,), SI units."""
    i = 0 if head == "left" else 1
    sight, rows = sights[i], slice(2 * i, 2 * i + 2)
    by_point = (sight.lens @ slope[rows])[None]
    inside = sight.placed.inside(point)[None]
    placed = sight.placed
    pixels = camera_pixels((key,), placed.camera, placed.pan, inside, point[None], by_point)[0]
    moved = np.zeros(4)
    moved[rows] = np.linalg.solve(sight.lens, pixels[0])
    return moved
