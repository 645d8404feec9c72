"""From a camera's settings to its driver."""

from functools import partial

from verify.cameras.grabbing import Grabbing
from verify.cameras.opencv import OpenCvSource
from verify.cameras.protocols import Camera, CameraSettings
from verify.cameras.replay import Replay
from verify.cameras.stream import StreamSource


def open_camera(settings: CameraSettings) -> Camera:
    """Open a camera: index or device path through OpenCV, URL through ffmpeg, or a file.

    A camera that is not there is looked for until it is.

    Raises:
        InputError: a file that does not exist.
    """
    source = settings.source
    if is_file(source):
        return Replay(settings)
    if isinstance(source, str) and "://" in source:
        return Grabbing(source, partial(StreamSource, settings), settings.size)
    name = source if isinstance(source, str) else f"camera {source}"
    return Grabbing(name, partial(OpenCvSource, settings), settings.size)


def is_file(source: int | str) -> bool:
    """Whether a camera's source is a video file or a folder of pictures."""
    return isinstance(source, str) and "://" not in source and not source.startswith("/dev/")
