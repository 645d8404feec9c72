"""Carry the spots of both cameras to one instant along their image motion.

The pictures of a pair are not simultaneous, and with a rolling shutter each row has its own
instant: t_i = t + (row - (height - 1) / 2) line_time. Model of spot i, with its LED's sightings in
n of the pairs before, after and before the one before:

    z_i(t) = polynomial of order n through the n + 1 sightings + h_i a_i

    symbol  meaning                                                     unit
    z_i     centre, (2,)                                                px
    n       number of those pairs: 1 gives a line, 2 a parabola         1
    a_i     derivative of order n + 1 of the image motion, which the
            sightings do not show: acceleration, jerk, snap. The pose
            fit takes it as a rigid body's with a prior                 px/s^(n+1)
    h_i     its lever: error by one unit                                s^(n+1)
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from verify.core.records import Array, Flags, Index, Sighting, Spots, take_rows
from verify.core.rig import Camera, Rig
from verify.measurement.kernels.entries import SpotView, align_spots

# Beyond such a gap between two pairs the motion at either is unknown: single visits, at rest.
MAX_GAP = 1.5  # s
NOTHING: SpotView = (
    0, np.zeros(0, np.int64), np.zeros((0, 2)), np.zeros((0, 2, 2)), np.zeros(0)
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class RawSightings:
    """LEDs in both pictures of a pair, the left one's first, each at its own instant."""

    led: Index  # (s,), index into marker.leds
    centre: Array  # (s, 2), px, distorted
    covariance: Array  # (s, 2, 2), px²
    peak: Array  # (s,), DN
    taken: Array  # (s,), s, the instant of each spot (differs by row with a rolling shutter)
    depth: Array  # (s,), m, rough distance along the optical axis
    width: Array  # (s,), px, full width at half height
    merged: Flags  # (s,), the width may not be that of the LED alone
    left: int  # spots of the left picture
    instants: tuple[float, float]  # s, of the pictures' middle rows, left and right
    pans: tuple[float, float]  # rad, as read

    def __len__(self) -> int:
        return len(self.led)

    @property
    def sides(self) -> tuple[slice, slice]:
        """Rows of the left picture and of the right one."""
        return slice(0, self.left), slice(self.left, len(self.led))

    def take(self, keep: Flags) -> "RawSightings":
        """Keep some of the spots, (s,)."""
        return replace(take_rows(self, keep), left=int(np.count_nonzero(keep[: self.left])))


@dataclass(frozen=True, slots=True)
class AlignedSightings:
    """LEDs in both pictures of a pair, the left one's first, at one instant."""

    raw: RawSightings
    t: float  # s
    centre: Array  # (s, 2), px, distorted
    covariance: Array  # (s, 2, 2), px²
    velocity: Array  # (s, 2), px/s
    lever: Array  # (s, 3), s², s³, s⁴

    @property
    def sides(self) -> tuple[Sighting, Sighting]:
        """The left picture's, and the right one's."""
        left, right = (
            Sighting(
                self.raw.led[own], self.centre[own], self.covariance[own], self.t, pan,
                self.raw.peak[own], self.velocity[own], self.lever[own],
            )
            for own, pan in zip(self.raw.sides, self.raw.pans, strict=True)
        )  # fmt: skip
        return left, right


def spot_instants(t: float, centre: Array, camera: Camera, height: int) -> Array:
    """Instants of the spots, (m,), s, by their rows; `t` is the middle row's instant."""
    rows: Array = centre[:, 1] - (height - 1) / 2
    return t + rows * camera.line_time


def raw_sightings(
    spots: tuple[Spots, Spots],
    found: tuple[tuple[Index, Index], ...],
    rig: Rig,
    taken: tuple[tuple[float, float], tuple[float, float], int],
    depths: tuple[Array, Array],
) -> RawSightings:
    """Gather both cameras' assigned spots, each at its own instant.

    `found`: LEDs and their spots, of the left picture and of the right one; `taken`: the middle
    rows' instants, s, the pan readings, rad, and the pictures' height, px; `depths`, m, of each.
    """
    (instants, pans, height), cameras = taken, (rig.left, rig.right)
    seen = [take_rows(own, index) for own, (_, index) in zip(spots, found, strict=True)]
    times = [
        spot_instants(t, own.centre, camera, height)
        for t, own, camera in zip(instants, seen, cameras, strict=True)
    ]
    return RawSightings(
        led=np.concatenate([led for led, _ in found]),
        centre=np.concatenate([own.centre for own in seen]),
        covariance=np.concatenate([own.covariance for own in seen]),
        peak=np.concatenate([own.peak for own in seen]),
        taken=np.concatenate(times),
        depth=np.concatenate(depths),
        width=np.concatenate([own.diameter for own in seen]),
        merged=np.concatenate([own.merged for own in seen]),
        left=len(seen[0]),
        instants=instants,
        pans=pans,
    )


def align(
    now: RawSightings,
    around: Sequence[RawSightings | None],
    t: float,
    rig: Rig,
    *,
    alone: bool = False,
) -> AlignedSightings | None:
    """Carry a pair's spots, as sighted `now`, to the instant `t`, s, of the pair.

    `around`: the sightings of the pairs before, after, and before the one before; None where there
    is none. `alone`: the pair is a single visit, far in time from its neighbours: taken as standing
    still. Gives None where spots have to be moved and no neighbour shows how.
    """
    if alone:
        still = np.zeros((len(now), 2)), np.zeros((len(now), 3))
        return AlignedSightings(now, t, now.centre, now.covariance, *still)
    one, two, three = (_view(other, now.pans, rig) for other in around)
    aligned, *carried = align_spots(_view(now, now.pans, rig), (one, two, three), t)
    return AlignedSightings(now, t, *carried) if aligned else None


def _view(raw: RawSightings | None, pans: tuple[float, float], rig: Rig) -> SpotView:
    """Sightings as the kernel takes them, as the pan angles, rad, would show them."""
    if raw is None:
        return NOTHING
    centre = raw.centre if raw.pans == pans else _turn(raw, pans, rig)
    return raw.left, raw.led, centre, raw.covariance, raw.taken


def _turn(raw: RawSightings, pans: tuple[float, float], rig: Rig) -> Array:
    """Centres (s, 2), px, as other pan angles, rad, would show them."""
    turned = []
    for own, camera, then, pan in zip(
        raw.sides, (rig.left, rig.right), raw.pans, pans, strict=True
    ):
        one = np.ones((len(raw.led[own]), 1))
        rays = np.concatenate([camera.normalise(raw.centre[own]), one], axis=1)
        points = np.concatenate([rays * raw.depth[own, None], one], axis=1)
        now_T_then = camera.camera_T_rig(pan) @ camera.rig_T_camera(then)
        turned.append(camera.project((points @ now_T_then.T)[:, :3]))
    return np.concatenate(turned)
