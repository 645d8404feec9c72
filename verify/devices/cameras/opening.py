"""From a camera's settings to its driver."""

from functools import partial

from verify.devices.cameras.capture import CameraCapture
from verify.devices.cameras.opencv import OpenCvSource
from verify.devices.cameras.replay import ReplaySource
from verify.devices.cameras.stream import StreamSource
from verify.devices.protocols import CameraDevice, CameraSettings


def open_camera(settings: CameraSettings) -> CameraDevice:
    """Open a camera: index or device path through OpenCV, URL through ffmpeg, or a file.

    A camera that is not there is looked for until it is.

    Raises:
        InputError: a file that does not exist.
    """
    source = settings.source
    if is_file(source):
        return ReplaySource(settings)
    if isinstance(source, str) and "://" in source:
        return CameraCapture(source, partial(StreamSource, settings), settings.size)
    name = source if isinstance(source, str) else f"camera {source}"
    return CameraCapture(name, partial(OpenCvSource, settings), settings.size)


def is_file(source: int | str) -> bool:
    """Whether a camera's source is a video file or a folder of pictures."""
    return isinstance(source, str) and "://" not in source and not source.startswith("/dev/")
