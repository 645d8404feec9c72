"""Is the robot where it says it is: flange pose from two cameras, compared with the encoders."""

from importlib.metadata import PackageNotFoundError, version

try:
    __version__ = version("verify-robot")
except PackageNotFoundError:  # run from a source tree that was never installed
    __version__ = "0+unknown"
