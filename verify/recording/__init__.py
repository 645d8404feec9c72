"""Recording: what cameras and encoders deliver, as a session folder that is whole at any moment."""

from verify.recording.part import Facts
from verify.recording.recorder import Recorder, RecorderState

__all__ = ["Facts", "Recorder", "RecorderState"]
