"""A picture where two processes see it."""

from multiprocessing.shared_memory import SharedMemory

import numpy as np

from verify.records import Image


class SharedPicture:
    """Room for one picture; it grows when pictures do."""

    def __init__(self) -> None:
        self._memory: SharedMemory | None = None

    def put(self, image: Image) -> tuple[str, tuple[int, ...]]:
        """Put a picture there; name and shape, by which `picture_of` finds it."""
        if self._memory is None or self._memory.size < image.nbytes:
            self.close()
            self._memory = SharedMemory(create=True, size=image.nbytes)
        view = np.ndarray(image.shape, dtype=np.uint8, buffer=self._memory.buf)
        view[:] = image
        return self._memory.name, image.shape

    def close(self) -> None:
        """Give the room back."""
        if self._memory is not None:
            self._memory.close()
            self._memory.unlink()
            self._memory = None


_attached: dict[str, SharedMemory] = {}  # in the other process: until the pictures grow
_MOST = 4  # attached at once: two pictures, and their places before they grew


def picture_of(name: str, shape: tuple[int, ...]) -> Image:
    """Look at a picture that another process has put there; it holds until the next one."""
    if name not in _attached:
        while len(_attached) >= _MOST:
            _attached.pop(next(iter(_attached))).close()
        _attached[name] = SharedMemory(name=name)
    return np.ndarray(shape, dtype=np.uint8, buffer=_attached[name].buf)
