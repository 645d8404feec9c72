"""Pictures as a report carries them along: a photograph as JPEG where that is much smaller."""

import io

from PIL import Image

MAX_SHARE = 0.5  # of the PNG's bytes: a JPEG that is larger stays a PNG, which loses nothing
QUALITY = 88


def compact(png: bytes) -> tuple[str, bytes]:
    """Give a PNG's media type and bytes, or those of a JPEG that takes less than half."""
    with Image.open(io.BytesIO(png)) as picture:
        if picture.mode not in ("RGB", "L"):  # JPEG has neither palette nor transparency
            return "image/png", png
        buffer = io.BytesIO()
        picture.save(buffer, "JPEG", quality=QUALITY, subsampling=0)
    jpeg = buffer.getvalue()
    if len(jpeg) < MAX_SHARE * len(png):
        return "image/jpeg", jpeg
    return "image/png", png
