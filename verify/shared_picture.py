"""A picture where two processes see it."""

import math
from multiprocessing.shared_memory import SharedMemory

import numpy as np

from verify.records import Image

Place = tuple[str, tuple[int, ...]]  # name and shape


class SharedPicture:
    """Room for one picture; it grows when pictures do."""

    def __init__(self) -> None:
        self._memory: SharedMemory | None = None

    def room(self, shape: tuple[int, ...]) -> Place:
        """Make room; name and shape, by which `picture_of` finds it."""
        size = math.prod(shape)
        if self._memory is None or self._memory.size < size:
            self.close()
            self._memory = SharedMemory(create=True, size=size)
        return self._memory.name, shape

    def put(self, image: Image) -> Place:
        """Put a picture there; name and shape, as for `room`."""
        place = self.room(image.shape)
        self._view(image.shape)[:] = image
        return place

    def copy(self, shape: tuple[int, ...]) -> Image:
        """Take a copy of the picture that somebody has put into the room."""
        return self._view(shape).copy()

    def _view(self, shape: tuple[int, ...]) -> Image:
        assert self._memory is not None  # room was made
        return np.ndarray(shape, dtype=np.uint8, buffer=self._memory.buf)

    def close(self) -> None:
        """Give the room back."""
        if self._memory is not None:
            self._memory.close()
            self._memory.unlink()
            self._memory = None


_attached: dict[str, SharedMemory] = {}  # in the other process: until the pictures grow
_MOST = 4  # attached at once: two pictures, and their places before they grew


def place_of(image: Image) -> Place | None:
    """Say where a picture that `picture_of` gave stands; None for another one."""
    for name, memory in _attached.items():
        if memory.size >= image.nbytes and image.flags.c_contiguous:
            there = np.ndarray(image.shape, dtype=np.uint8, buffer=memory.buf)
            if there.ctypes.data == image.ctypes.data:
                return name, image.shape
    return None


def picture_of(name: str, shape: tuple[int, ...]) -> Image:
    """Look at a picture that another process has put there; it holds until the next one."""
    if name not in _attached:
        while len(_attached) >= _MOST:
            _attached.pop(next(iter(_attached))).close()
        _attached[name] = SharedMemory(name=name)
    return np.ndarray(shape, dtype=np.uint8, buffer=_attached[name].buf)
