"""Decide which postures may be planned with, and count what excludes the others.

An LED counts where both cameras see it inside the picture, within its angle of view, and apart from
the other LEDs' images.
"""

from dataclasses import dataclass

import numpy as np

import robots
from robots.coupling import LENGTH_SCALE
from verify.core.records import Array, Flags, Index
from verify.core.rig import Camera
from verify.planning.request import PlanningSetup, PlanRequest

MAX_CORNER_RATIO = 1.1  # of the picture's corner: farther out the lens' polynomial may fold back
MIN_DEPTH = 0.1  # m: no camera of this kind focuses nearer
MIN_SEPARATION = 1.5  # diameters between LED images that do not merge
MIN_LEDS = 3  # in both cameras: fewer leave a turn open
MARGIN_PX = 40.0  # at a pose; between poses half of it
MIN_SINGULAR_VALUE = 0.1  # least one of J, lengths over 143 mm: robots.coupling's own bound
MIN_SINGULAR_VALUE_PASSING = 0.03  # between poses
MIN_CAMERA_CLEARANCE = 0.15  # m of any link or LED from the cameras
MIN_LINK_DISTANCE = 0.08  # m between the middles of two links that do not touch
MIN_LINK_SEPARATION = 0.3  # m along the links: nearer points belong to one bend
CHUNK_POSTURES = 4000  # postures at a time
TOL_LIMIT = 1e-9  # rad: rounding at a limit

ROOM_REMEDY = "Give another --near or a wider --within-deg."
REMEDIES = {  # what excludes a posture, and what helps against it
    "fewer than 3 LEDs inside both pictures": "Turn the camera bases or move the rig: pan_deg and "
    "[robot_base] in rig.toml.",
    "LEDs turned away from a camera": "Move the rig to where the flange looks, or give a larger "
    "--view-angle-deg.",
    "LED images that merge": "Move the rig nearer, or the LEDs apart.",
    "the arm below the floor": "Give a lower --floor-mm.",
    "the arm too near to a camera": "Move the rig away from the arm.",
    "links of the arm too near to each other": ROOM_REMEDY,
    "near a singularity": ROOM_REMEDY,
}
REASONS = tuple(REMEDIES)
SPACING = 0.06  # m between the points that stand for a link
TOL_SHARE = 1e-9  # of SPACING: a piece of rounding alone gets no point


class LinkChain:
    """An arm of j joints as straight pieces from the base to the flange, and p points along them.

    Each link goes along its joint's axis, then across to the next joint, as d and a of a DH table.
    """

    def __init__(self, arm: robots.Arm) -> None:
        rest = robots.link_frames(arm, np.zeros((1, arm.dof)))  # at q = 0, (1, j + 1, 4, 4), m
        steps = np.diff(rest[0, :, :3, 3], axis=0)
        # how far each link goes along its joint's axis, (j,), m
        self._along: Array = np.sum(steps * rest[0, :-1, :3, 2], axis=1)
        length = np.linalg.norm(np.diff(self._corners(rest)[0], axis=0), axis=1)
        counts = np.ceil(length / SPACING - TOL_SHARE).astype(int)
        # of each point: on which piece it is, and at which share of its length
        self._piece: Index = np.repeat(np.arange(len(length)), counts)
        self._share: Array = np.concatenate([np.arange(1, n + 1) / n for n in counts.tolist()])
        before = np.concatenate([[0.0], np.cumsum(length)])[self._piece]
        # how far along the links each point is from the base, (p,), m
        self.way: Array = before + self._share * length[self._piece]
        # which points some joint moves, (p,): not those on the first axis
        self.moving: Flags = self.way > length[:2].sum() + SPACING / 10

    def points(self, frames: Array) -> Array:
        """Points along the links of `robots.link_frames` (m, j + 1, 4, 4): (m, p, 3), m."""
        corners, share = self._corners(frames), self._share[:, None]
        points: Array = corners[:, self._piece] * (1 - share)
        points += corners[:, self._piece + 1] * share
        return points

    def _corners(self, frames: Array) -> Array:
        """Ends of the straight pieces, from the base on, (m, 2 j + 2, 3), m."""
        corners = [np.zeros((len(frames), 3)), frames[:, 0, :3, 3]]
        for j, along in enumerate(self._along):
            origin, axis = frames[:, j, :3, 3], frames[:, j, :3, 2]
            corners += [origin + along * axis, frames[:, j + 1, :3, 3]]
        return np.stack(corners, axis=1)


def dexterity(frames: Array) -> Array:
    """Least singular value of the Jacobian, lengths over 143 mm, (m,): 0 at a singularity."""
    axes, flange = frames[:, :-1, :3, 2], frames[:, -1, :3, 3]
    levers = flange[:, None] - frames[:, :-1, :3, 3]
    columns = np.concatenate([np.cross(axes, levers) / LENGTH_SCALE, axes], axis=2)
    return np.asarray(np.linalg.svd(columns, compute_uv=False)[:, -1])


@dataclass(frozen=True, slots=True)
class PredictedView:
    """Images of n LEDs at m poses in one camera."""

    pixels: Array  # (m, n, 2), px; nan behind the camera or far outside
    inside: Flags  # (m, n), clear of the picture's rim
    facing: Flags  # (m, n), the camera stands within the LEDs' angle of view
    apart: Flags  # (m, n), no other LED's image touches


def visible_leds(
    setup: PlanningSetup, base_T_flange: Array, margin: float, angle: float
) -> tuple[PredictedView, PredictedView]:
    """Predict the LED images of flange poses (m, 4, 4), m, in both cameras at the rig's own pan.

    The margin is px between an LED's centre and the picture's rim, the angle rad from the flange's
    z within which LEDs are seen.
    """
    rig_T_flange = setup.rig.rig_T_base @ base_T_flange
    points = setup.marker.leds @ np.swapaxes(rig_T_flange[:, :3, :3], 1, 2)
    points += rig_T_flange[:, None, :3, 3]
    left, right = (
        _view(setup, camera, points, rig_T_flange[:, :3, 2], margin, angle)
        for camera in (setup.rig.left, setup.rig.right)
    )
    return left, right


def _view(
    setup: PlanningSetup, camera: Camera, points: Array, normal: Array, margin: float, angle: float
) -> PredictedView:
    placed = camera.camera_T_rig(camera.pan)
    local = points @ placed[:3, :3].T + placed[:3, 3]
    depth = local[..., 2]
    near = np.maximum(depth, MIN_DEPTH)[..., None]
    size = np.array(setup.rig.image_size, dtype=float) - 1
    corners = np.array([[0.0, 0.0], [size[0], 0.0], [0.0, size[1]], size])
    widest = MAX_CORNER_RATIO * float(np.linalg.norm(camera.normalise(corners), axis=1).max())
    valid = (depth > MIN_DEPTH) & (np.linalg.norm(local[..., :2] / near, axis=-1) < widest)
    pixels = camera.project(np.concatenate([local[..., :2], near], axis=-1))
    pixels[~valid] = np.nan
    inside = np.all((pixels > margin) & (pixels < size - margin), axis=-1)  # nan is outside
    toward = camera.rig_T_camera(camera.pan)[:3, 3] - points
    toward /= np.linalg.norm(toward, axis=-1, keepdims=True)
    facing = np.einsum("mni,mi->mn", toward, normal) > np.cos(angle)
    diameter = camera.matrix[0, 0] * setup.marker.led_diameter / near[..., 0]
    gaps = np.linalg.norm(pixels[:, :, None] - pixels[:, None], axis=-1)
    gaps[:, range(len(setup.marker)), range(len(setup.marker))] = np.inf
    merged = gaps < MIN_SEPARATION * diameter[:, :, None]  # of one that is not in view, nan: none
    return PredictedView(pixels, inside, facing, ~merged.any(axis=2))


class PostureConstraints:
    """What a posture must satisfy."""

    def __init__(self, setup: PlanningSetup, request: PlanRequest) -> None:
        self.setup, self.request = setup, request
        lower, upper, near = setup.arm.lower, setup.arm.upper, request.near
        if near is not None:
            lower = np.maximum(lower, near - request.within)
            upper = np.minimum(upper, near + request.within)
        self.limits = lower, upper  # least and greatest joint angles, (j,) each, rad
        self._links = LinkChain(setup.arm)
        # the LEDs go on where the links end, as far as each is from the flange
        reach = np.linalg.norm(setup.marker.leds, axis=1)
        way = np.concatenate([self._links.way, self._links.way[-1] + reach])
        self._moving: Flags = np.concatenate([self._links.moving, reach >= 0])
        # pairs of points that are far from each other along the links: first (n,), second (n,)
        apart = np.abs(way[:, None] - way)
        self._apart = np.nonzero(np.triu(apart > MIN_LINK_SEPARATION))
        base_T_rig = np.linalg.inv(setup.rig.rig_T_base)
        placed = [c.rig_T_camera(c.pan) for c in (setup.rig.left, setup.rig.right)]
        # the cameras' optical centres in the base frame, (2, 3), m
        self._cameras: Array = np.array([(base_T_rig @ one)[:3, 3] for one in placed])

    def reason(self, q: Array, *, passing: bool = False) -> Index:
        """Find the first of REASONS that excludes each posture q (m, j), rad: (m,), -1 for none.

        Postures are within the joints' limits; `passing` between two poses, the rim and
        singularities may be nearer.
        """
        parts = [
            self._reason(q[i : i + CHUNK_POSTURES], passing)
            for i in range(0, len(q), CHUNK_POSTURES)
        ]
        return np.concatenate(parts) if parts else np.zeros(0, dtype=np.int64)

    def good(self, q: Array, *, passing: bool = False) -> Flags:
        """Whether each posture (m, j) keeps the joint limits and all constraints, (m,)."""
        lower, upper = self.limits
        inside = np.all((q >= lower - TOL_LIMIT) & (q <= upper + TOL_LIMIT), axis=1)
        inside[inside] = self.reason(q[inside], passing=passing) < 0
        return np.asarray(inside, dtype=bool)

    def _reason(self, q: Array, passing: bool) -> Index:
        margin = MARGIN_PX / 2 if passing else MARGIN_PX
        frames = robots.link_frames(self.setup.arm, q)
        left, right = visible_leds(self.setup, frames[:, -1], margin, self.request.view_angle)
        inside = left.inside & right.inside
        facing = inside & left.facing & right.facing
        apart = facing & left.apart & right.apart
        few = [leds.sum(axis=1) < MIN_LEDS for leds in (inside, facing, apart)]
        reason = np.select(few, range(len(few)), -1)
        left_over = np.flatnonzero(reason < 0)
        reason[left_over] = self._arm_reason(frames[left_over], passing)
        return reason

    def _arm_reason(self, frames: Array, passing: bool) -> Index:
        """Check arm and LEDs: floor, cameras, the arm's own links, singularities."""
        flange, leds = frames[:, -1], self.setup.marker.leds
        leds = leds @ np.swapaxes(flange[:, :3, :3], 1, 2) + flange[:, None, :3, 3]
        points = np.concatenate([self._links.points(frames), leds], axis=1)
        raised = points[:, self._moving]
        away = np.linalg.norm(raised[:, :, None] - self._cameras, axis=-1).min(axis=(1, 2))
        first, second = self._apart
        gaps = np.linalg.norm(points[:, first] - points[:, second], axis=-1)
        least = MIN_SINGULAR_VALUE_PASSING if passing else MIN_SINGULAR_VALUE
        broken = (
            (raised[:, :, 2] < self.request.floor).any(axis=1),
            away < MIN_CAMERA_CLEARANCE,
            gaps.min(axis=1, initial=np.inf) < MIN_LINK_DISTANCE,
            dexterity(frames) < least,
        )
        return np.select(broken, range(len(REASONS) - len(broken), len(REASONS)), -1)
