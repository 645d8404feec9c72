"""All that measuring takes, loaded by being imported: see nursery.py."""

from contextlib import suppress

import cv2

from verify.batch import tasks
from verify.warm_up import warm_up, warm_up_comparison

__all__ = ["tasks"]

cv2.setNumThreads(1)  # threads are not copied: each worker has its own
with suppress(Exception):  # whatever is wrong, the first session says it better
    warm_up()
    warm_up_comparison()
