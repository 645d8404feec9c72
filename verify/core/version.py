"""The version of the installed package, as every result states it."""

from importlib.metadata import PackageNotFoundError, version

try:
    __version__ = version("verify-robot")
except PackageNotFoundError:  # run from a source tree that was never installed
    __version__ = "0+unknown"
