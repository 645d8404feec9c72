"""One camera's pictures to a target's place in them: the tracker without stereo.

The same rules as in stereo, in pixels: a window predicted from the track, a search of the whole
picture while the target is out of sight, and nothing believed that is not of its colours and size.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from verify.grab.camshift import Blob, Box, around, camshift
from verify.grab.camshift_search import find_all
from verify.grab.colour import ColourModel
from verify.grab.target import Options, Status
from verify.grab.target_association import Candidate, Known
from verify.grab.target_identity import Identity, lacking
from verify.records import Image

SPEED = 200.0  # px/s, standard deviation a coordinate
ALIKE = 0.7  # least similarity of the mixture of colours
LIES = 0.01  # of the extent: by as much the colour's centre wanders on a thing at rest


@dataclass(frozen=True, slots=True)
class PictureSeen:
    """What one picture says of the target."""

    t: float  # s
    status: Status
    reason: str
    blob: Blob | None  # None where it is not seen


def follow(
    pictures: Iterable[tuple[float, Image]],
    model: ColourModel,
    start: Box | None = None,
    options: Options | None = None,
) -> Iterator[PictureSeen]:
    """Follow a target through one camera's pictures.

    Args:
        pictures: time in s and (h, w, 3) BGR.
        model: the target's colours.
        start: the target's box in the first picture; None: found by its colour alone.
        options: `coast` and `confirm` of them matter here.

    Raises:
        InputError: a picture is grey.
    """
    identity: Identity | None = None
    for t, image in pictures:
        if identity is None:
            density = 1.0 / (image.shape[0] * image.shape[1])
            identity = Identity(options or Options(), density, SPEED)
            blob = None if start is None else camshift(image, start, start, model)
            if blob is not None:
                identity.choose(t, _candidates([blob], None)[0])
                yield PictureSeen(t, "tracked", "", blob)
                continue
        found = _look(image, t, identity, model)
        verdict = identity.step(t, _candidates(found, identity.target))
        blob = None if verdict.chosen is None else found[verdict.chosen]
        if blob is not None and verdict.status == "tracked":
            model = model.in_light(blob.value)
        yield PictureSeen(t, verdict.status, verdict.reason, blob)


def _look(image: Image, t: float, identity: Identity, model: ColourModel) -> list[Blob]:
    """Search the predicted window; the whole picture where the target was not seen last."""
    known = identity.target
    if known is None or not identity.tracked:
        extent = None if known is None else known.extent
        return [blob for blob in find_all(image, model, expected=extent) if _fits(blob)]
    track = known.track.at(t)
    sigma = np.sqrt(np.diag(track.position_covariance))
    start = around(track.position, 0.5 * known.extent + sigma)
    region = around(track.position, 0.75 * known.extent + 4 * sigma + 4)
    blob = camshift(image, start, region, model, known.extent)
    return [blob] if blob is not None and _fits(blob) else []


def _fits(blob: Blob) -> bool:
    return blob.similarity >= ALIKE and not blob.cut


def _candidates(blobs: list[Blob], target: Known | None) -> list[Candidate]:
    lacks = [0.0 if target is None else lacking(b.area / target.area) for b in blobs]
    return [
        Candidate(
            position=blob.centre,
            covariance=blob.covariance + np.diag((lack * blob.extent) ** 2),
            systematic=np.diag((LIES * blob.extent) ** 2),
            area=blob.area,
            largest=blob.area,
            reach=blob.reach,
            extent=blob.extent,
            index=index,
        )
        for index, (blob, lack) in enumerate(zip(blobs, lacks, strict=True))
    ]
