"""Track a coloured object in 3D through stereo pairs.

CAMSHIFT searches each picture where the Kalman track predicts the target; what both cameras find
must be one object, of the target's size, where the target can be. Otherwise, and regularly for
others of its colour, the whole pictures are searched.
"""

from collections.abc import Iterable, Iterator

import numpy as np

from verify.core.records import Image, StereoPair
from verify.core.rig import Rig
from verify.grasping.tracking import search
from verify.grasping.tracking.association import TargetDecision, TargetIdentity
from verify.grasping.tracking.camshift import Blob
from verify.grasping.tracking.colour import ColourModel, blend, named_colour
from verify.grasping.tracking.pairing import StereoObject
from verify.grasping.tracking.selection import counterpart, model_from_box
from verify.grasping.tracking.target import (
    BoxSelection,
    ColourSelection,
    Target,
    TargetObservation,
    TrackingOptions,
)

DEFAULTS = TrackingOptions()
CLUTTER_DENSITY = 0.1  # objects of the colour that come up, a m³
RELEARN_PERIOD = 0.3  # s between two updates of the colours, where they adapt


def track(
    pairs: Iterable[StereoPair], rig: Rig, target: Target, options: TrackingOptions = DEFAULTS
) -> Iterator[TargetObservation]:
    """Track a coloured object through stereo pairs, a record a pair.

    A pair that says nothing is a record whose status and reason say why.

    Raises:
        InputError: grey pictures, an unknown colour, a box that lies outside the picture or holds
            no colour of its own.
    """
    tracker = TargetTracker(rig, target, options)
    for pair in pairs:
        yield tracker.step(pair)


class TargetTracker:
    """`track`, a pair at a time.

    Raises:
        InputError: the colour is not known.
    """

    def __init__(self, rig: Rig, target: Target, options: TrackingOptions = DEFAULTS) -> None:
        self._rig, self._options = rig, options
        self._target = target
        self._identity = TargetIdentity(options, CLUTTER_DENSITY)
        self._models: tuple[ColourModel, ColourModel] | None = None  # left, right
        if isinstance(target, ColourSelection):
            self._models = (named_colour(target.colour), named_colour(target.colour))
        self._systematic = np.zeros((3, 3))
        self._count, self._learned = 0, -np.inf
        self._size_uncertainty = np.full(2, np.nan)

    def step(self, pair: StereoPair) -> TargetObservation:
        """Take one pair.

        Raises:
            InputError: see `track`.
        """
        self._count += 1
        if self._models is None and isinstance(self._target, BoxSelection):
            self._models, selected = counterpart(pair, self._rig, self._target, self._options)
            if selected is not None:
                self._identity.choose(pair.t_left, selected)
                self._learn(pair, selected)
                return self._observation(
                    pair, TargetDecision("tracked", "", selected), search.NO_WINDOWS
                )
        things, windows = search.search_pair(
            self._now(pair), self._count % search.SEARCH_PERIOD == 0
        )
        decision = self._identity.step(pair.t_left, things)
        if decision.chosen is not None and decision.status == "tracked":
            self._learn(pair, decision.chosen)
        return self._observation(pair, decision, windows)

    def _now(self, pair: StereoPair) -> search.TargetSearch:
        assert self._models is not None  # known by name, or learned from the first pair
        return search.TargetSearch(pair, self._rig, self._options, self._models, self._identity)

    def _learn(self, pair: StereoPair, thing: StereoObject) -> None:
        """Follow the light; learn the colours at first sight, and again where that is wanted."""
        self._systematic, self._size_uncertainty = thing.place.systematic, thing.size_uncertainty
        adapts = self._options.adaptation > 0 and pair.t_left - self._learned > RELEARN_PERIOD
        if adapts:
            self._learned = pair.t_left
        share = min(1.0, self._options.adaptation * RELEARN_PERIOD) if adapts else 0.0
        left, right = self._now(pair).models
        self._models = (
            _update_model(left, pair.left, thing.left, share),
            _update_model(right, pair.right, thing.right, share),
        )

    def _observation(
        self, pair: StereoPair, decision: TargetDecision, windows: search.Windows
    ) -> TargetObservation:
        target, thing, reason = self._identity.target, decision.chosen, decision.reason
        nothing, square = np.full(3, np.nan), np.full((3, 3), np.nan)
        centre, covariance, velocity, spread = nothing, square, nothing, square
        if target is not None and pair.t_left - target.t <= self._options.coast:
            now = target.track.at(pair.t_left)
            centre, covariance = now.position, now.position_covariance + self._systematic
            velocity, spread = now.velocity, now.velocity_covariance
            if decision.status == "lost" and (side := search.left_picture(self._now(pair), now)):
                reason = f"it has left the {side} picture"
        return TargetObservation(
            frame=pair.frame,
            t=pair.t_left,
            status=decision.status,
            reason=reason,
            left=None if thing is None else thing.left,
            right=None if thing is None else thing.right,
            windows=windows,
            centre=centre,
            covariance=covariance,
            velocity=velocity,
            velocity_covariance=spread,
            measured=nothing if thing is None else thing.place.point,
            size=np.full(2, np.nan) if target is None else target.extent,
            size_standard_uncertainty=self._size_uncertainty,
            epipolar=float("nan") if thing is None else thing.place.mismatch,
            quality=0.0 if thing is None or target is None else _quality(thing, target.area),
        )


def _update_model(model: ColourModel, image: Image, blob: Blob, share: float) -> ColourModel:
    """Learn a colour that is known by name alone; else move it by a share, and with the light."""
    if model.mixture is None:
        return model_from_box(image, blob.box, model)
    if share > 0:
        model = blend(model, model_from_box(image, blob.box, model), share)
    return model.in_light(blob.value)


def _quality(thing: StereoObject, area: float) -> float:
    """Share, similarity and completeness of the worse picture, multiplied; `area` m² expected."""
    completeness: list[float] = [min(ratio, 1 / ratio) for ratio in (thing.areas / area).tolist()]
    return min(
        blob.share * blob.similarity * complete
        for blob, complete in zip((thing.left, thing.right), completeness, strict=True)
    )
