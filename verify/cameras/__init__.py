"""Cameras: pictures with their time, settings asked for and read back, states in words.

One module a driver. Times are seconds on the host's monotonic clock, mid-exposure as well as the
platform tells. A camera that is gone is looked for again by its own driver.
"""

from verify.cameras.protocols import (
    READ_LIMIT,
    Camera,
    CameraFrame,
    CameraSettings,
    CameraState,
    Refusal,
    TakenPair,
)

__all__ = [
    "READ_LIMIT",
    "Camera",
    "CameraFrame",
    "CameraSettings",
    "CameraState",
    "Refusal",
    "TakenPair",
]
