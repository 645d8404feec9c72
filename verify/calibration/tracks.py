"""The LEDs of an arm without a marker file: bright points that move together as one rigid body.

Lamps, highlights and reflections are bright too. What tells LEDs from them is that the arm carries
them: they do not stand still, and their mutual distances stay. No two pairs need to be near in
time, so single visits serve as well as a motion.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from verify.calibration.tracks_rigid import Cloud, rigid_body
from verify.detection import detect
from verify.errors import InputError
from verify.measurement import MINIMUM_DEPTH, MOTION_FLOOR_PX, UNKNOWN_SPEED_PX
from verify.records import Array, Spots
from verify.rig import Rig
from verify.session import Recording
from verify.triangulation import rays, triangulate

Progress = Callable[[int, int], None]

MOST_LEDS = 6  # as identification takes them
EPIPOLAR_PX = 1.0  # what calibration and merged spots leave of two rays that should meet
FARTHEST = 5.0  # m: beyond it no LED of 5 mm fills two pixels
SAME_PLACE_PX = 1.5  # a lamp's image wanders less, an LED's on a moving arm more
STANDING = 0.5  # share of the pairs in which a spot at one place is none of the arm's
# Between the exposures an LED moves; how differently two LEDs of one body do spoils the distance
# between them. 1 rad/s at 50 mm, seen in depth four times enlarged.
UNEVEN_SPEED = 0.2  # m/s
LEAST_PLAY = 1.5e-3  # m: depth of a spot that is half a pixel off
FEWEST_PAIRS = 5  # alike enough to say that a spot stands still


@dataclass(frozen=True, slots=True)
class Look:
    """The bright spots of one stereo pair."""

    frame: int
    t: tuple[float, float]  # s, left and right
    pan: tuple[float, float]  # rad
    spots: tuple[Spots, Spots]
    height: int  # px, of the image


def look(recording: Recording, progress: Progress) -> list[Look]:
    """Find the spots of every pair.

    Raises:
        InputError: an image cannot be decoded.
    """
    looks = []
    for pair in recording.pairs():
        looks.append(
            Look(
                frame=pair.frame,
                t=(pair.t_left, pair.t_right),
                pan=(pair.pan_left, pair.pan_right),
                spots=(detect(pair.left), detect(pair.right)),
                height=pair.left.shape[0],
            )
        )
        progress(len(looks), len(recording))
    return looks


def without_what_stands(looks: Sequence[Look]) -> list[Look]:
    """Leave out spots that are at one place of an image in most pairs: lamps, highlights."""
    sides = []
    for side in (0, 1):
        found = [seen.spots[side].centre for seen in looks]
        pan = np.array([seen.pan[side] for seen in looks])
        sides.append([~_stands(i, found, pan) for i in range(len(looks))])
    return [
        replace(seen, spots=(_some(seen.spots[0], left), _some(seen.spots[1], right)))
        for seen, left, right in zip(looks, *sides, strict=True)
    ]


def _stands(i: int, found: list[Array], pan: Array) -> NDArray[np.bool_]:
    """Which spots of pair i are where others with the same pan reading have one, too."""
    alike = [j for j in np.flatnonzero(pan == pan[i]).tolist() if j != i]
    if len(alike) + 1 < FEWEST_PAIRS or not len(found[i]):
        return np.zeros(len(found[i]), dtype=bool)
    again = np.zeros(len(found[i]))
    for j in alike:
        if len(found[j]):
            apart = np.linalg.norm(found[i][:, None] - found[j][None], axis=2)
            again += apart.min(axis=1) < SAME_PLACE_PX
    stands: NDArray[np.bool_] = again > STANDING * len(alike)
    return stands


def _some(spots: Spots, keep: NDArray[np.bool_]) -> Spots:
    return Spots(
        centre=spots.centre[keep],
        covariance=spots.covariance[keep],
        peak=spots.peak[keep],
        diameter=spots.diameter[keep],
        elongation=spots.elongation[keep],
        misfit=spots.misfit[keep],
        saturated=spots.saturated[keep],
        merged=spots.merged[keep],
        colour=spots.colour[keep],
        noise=spots.noise,
    )


def motion_px(seen: Look) -> float:
    """How far LEDs may move in the image between the two exposures, px."""
    return MOTION_FLOOR_PX + UNKNOWN_SPEED_PX * abs(seen.t[1] - seen.t[0])


def points(seen: Look, rig: Rig) -> Cloud:
    """Every point in the rig at which a left and a right spot may have met."""
    left, right = (spots.centre for spots in seen.spots)
    if not len(left) or not len(right):
        return Cloud(np.zeros((0, 3)), np.zeros((0, 2), dtype=np.int64), 0.0)
    at, gap = triangulate(rig.left, rig.right, *seen.pan, left[:, None], right[None])
    centre, _ = rays(rig.left, seen.pan[0], left[:1])
    distance = np.linalg.norm(at - centre, axis=2)
    gap_px = gap / np.where(distance > 0, distance, np.inf) * rig.left.matrix[0, 0]
    with np.errstate(invalid="ignore"):  # nan where the rays do not meet
        meets = (gap_px < EPIPOLAR_PX + motion_px(seen)) & (distance > MINIMUM_DEPTH)
        meets &= distance < FARTHEST
    index = np.argwhere(meets)
    play = LEAST_PLAY + UNEVEN_SPEED * abs(seen.t[1] - seen.t[0])
    return Cloud(at[meets], index.astype(np.int64), play)


def find_leds(looks: Sequence[Look], rig: Rig, leds: int | None, place: str) -> Array:
    """Find the LEDs as the rigid body that moves.

    Args:
        looks: the spots of every pair, those that stand still left out.
        rig: the cameras.
        leds: how many there are; None: as many as move together.
        place: the recording, for complaints.

    Returns:
        (n, 3), m, in a frame of their own, about their centroid; good to about a millimetre.

    Raises:
        InputError: nothing moves as one rigid body, or another number of LEDs does.
    """
    clouds = [points(seen, rig) for seen in looks]
    body = rigid_body([c for c in clouds if len(c.points) >= 3], leds or MOST_LEDS)
    if body is None:
        most = max((len(c.points) for c in clouds), default=0)
        raise InputError(
            place,
            f"no three bright points move together as one rigid body (at most {most} in a pair)",
            "three LEDs or more, off one line, in view of both cameras while the arm moves",
            "Light the LEDs, darken the room, and move several joints by 20° or more.",
        )
    if leds is not None and len(body) != leds:
        remedy = "Check that every LED is lit and in view of both cameras, or give the number seen."
        raise InputError(place, f"{len(body)} LEDs move together", f"{leds} are asked for", remedy)
    return body
