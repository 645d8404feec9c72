"""Define a target, what may be set of its tracking, and what one pair of pictures shows of it."""

from dataclasses import dataclass
from typing import Literal

from verify.core.records import Array
from verify.grasping.tracking.camshift import Blob, Box

# searching: not found yet; tracked: wholly in view of both cameras, and told from all others;
# occluded: in view in part, or merged with another of its colour, or not told from another;
# lost: not in view. Both end by themselves: the whole pictures are searched.
TrackingStatus = Literal["searching", "tracked", "occluded", "lost"]


@dataclass(frozen=True, slots=True)
class ColourSelection:
    """A target known by the name of its colour."""

    colour: str


@dataclass(frozen=True, slots=True)
class BoxSelection:
    """A target selected in one picture of the first pair."""

    box: Box  # x, y, width, height, px
    side: Literal["left", "right"] = "left"


Target = ColourSelection | BoxSelection


@dataclass(frozen=True, slots=True)
class TrackingOptions:
    """What may be set of tracking."""

    adaptation: float = 0.0  # share of the colours that is learned anew a second; 0: never
    coast: float = 0.7  # s out of sight for which its predicted place is given
    confirm: int = 3  # pairs in a row before a target is called found, or found again after `coast`
    sizes: tuple[float, float] = (0.008, 0.25)  # m, least and greatest width of a target
    depths: tuple[float, float] = (0.15, 5.0)  # m before the cameras
    speed: float = 0.5  # m/s, standard deviation a coordinate, of what moves targets


@dataclass(frozen=True, slots=True)
class TargetObservation:
    """The target by one pair; positions in the rig, at the left picture's instant."""

    frame: int
    t: float  # s
    status: TrackingStatus
    reason: str  # why it is not `tracked`; empty where it is
    left: Blob | None  # None: not found in that picture
    right: Blob | None
    windows: tuple[Box | None, Box | None]  # what was searched, left and right; None: all of it
    centre: Array  # (3,), m, filtered; predicted where it is out of sight; nan where lost
    covariance: Array  # (3, 3), m²: of the track, the colour's centre, and the rig as stated
    velocity: Array  # (3,), m/s
    velocity_covariance: Array  # (3, 3), (m/s)²
    measured: Array  # (3,), m, from this pair alone; nan where it gave none
    size: Array  # (2,), m, width and height along the pictures' rows and columns
    size_standard_uncertainty: Array  # (2,), m
    epipolar: float  # the rays' mismatch in standard deviations; nan where not in both
    # 0 to 1, of the worse picture: share, similarity, and area over expected area, multiplied
    quality: float
