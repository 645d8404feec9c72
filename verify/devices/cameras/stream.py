"""Cameras on the network: RTSP, and MJPEG over HTTP; JPEGs are kept as they come."""

import time
from collections import deque
from collections.abc import Iterator

import av

from verify.devices.cameras.opencv import as_image, one_channel
from verify.devices.protocols import CameraSettings, CapturedImage, RefusedSetting

CONNECT_TIMEOUT = 5.0  # s
SILENCE_TIMEOUT = 3.0  # s without data: the camera counts as lost
FFMPEG_OPTIONS = {"rtsp_transport": "tcp", "fflags": "nobuffer"}  # UDP loses pieces of pictures
MAX_CLOCK_DRIFT = 2e-4  # a camera's crystal is within 1e-4
DEFAULT_PERIOD = 1.0 / 30.0  # s, before the second picture
N_GAPS = 10  # gaps between pictures: the longest says how long one may have been under way


class StreamClock:
    """A stream's own time stamps, brought to the host's clock.

    A picture is never there before it was taken, so arrival less stamp has a floor: the quickest
    way through the network. Its constant part is taken up by the clock offset.
    """

    def __init__(self) -> None:
        self._floor = float("inf")
        self._last: float | None = None

    def taken(self, stamp: float, arrival: float) -> float:
        """Place a stamp, s, that arrived at `arrival`, s, on the host's clock."""
        risen = 0.0 if self._last is None else MAX_CLOCK_DRIFT * (arrival - self._last)
        self._last = arrival
        self._floor = min(self._floor + risen, arrival - stamp)
        return stamp + self._floor


class StreamSource:
    """An open stream.

    Raises:
        OSError: nobody answers, or what answers is no video.
    """

    def __init__(self, settings: CameraSettings) -> None:
        self._settings = settings
        url = str(settings.source)
        try:
            self._container = av.open(
                url, options=FFMPEG_OPTIONS, timeout=(CONNECT_TIMEOUT, SILENCE_TIMEOUT)
            )
            self._stream = self._container.streams.video[0]
        except (av.FFmpegError, OSError, IndexError) as error:
            raise OSError(_error_text(error)) from error
        self._stream.thread_type = "SLICE"  # threads that work a picture ahead would delay all
        self._packets: Iterator[av.Packet[av.VideoStream]] = iter(
            self._container.demux(self._stream)
        )
        self._clock = StreamClock() if url.startswith("rtsp") else None
        self._before: float | None = None
        self._gaps: deque[float] = deque(maxlen=N_GAPS)  # s
        names = ("size", "rate", "format", "exposure", "gain", "white_balance")
        self.refused = tuple(
            RefusedSetting(name, str(value), "as set at the camera itself")
            for name in names
            if (value := getattr(settings, name)) is not None
        )

    def grab(self) -> CapturedImage | None:
        """Wait for a picture; OSError: the stream is gone."""
        try:
            packet = next(self._packets)
            arrival = time.monotonic()
            frames = packet.decode() if packet.size else []
        except StopIteration:
            raise OSError("the stream has ended") from None
        except av.error.InvalidDataError:
            return None
        except (av.FFmpegError, OSError) as error:
            raise OSError(_error_text(error)) from error
        if not frames:
            return None
        assert isinstance(frames[0], av.VideoFrame)  # the stream is one of video
        image = one_channel(as_image(frames[0]), self._settings.grey)
        jpeg = self._stream.codec_context.name == "mjpeg" and not self._settings.grey
        t, uncertainty = self._taken(packet, arrival)
        return CapturedImage(t, uncertainty, image, bytes(packet) if jpeg else None)

    def close(self) -> None:
        """Close it."""
        self._container.close()

    def _taken(self, packet: "av.Packet[av.VideoStream]", arrival: float) -> tuple[float, float]:
        """When it was taken, and how well that is known: within a gap, for all one knows."""
        if self._before is not None:
            self._gaps.append(arrival - self._before)
        self._before = arrival
        t = arrival
        if self._clock is not None and packet.pts is not None and packet.time_base is not None:
            t = self._clock.taken(float(packet.pts * packet.time_base), arrival)
        return t - self._settings.delay, max(self._gaps, default=DEFAULT_PERIOD)


def _error_text(error: Exception) -> str:
    if isinstance(error, IndexError):
        return "the device there sends no video"
    text = getattr(error, "strerror", None) or str(error)
    return f"{text[:1].lower()}{text[1:]}" if text else type(error).__name__
