"""Compile the inner loops, so that no first run waits for it.

python -m verify.compile_ahead     after an installation
"""

import sys
import time

from verify.core.native import library_folder
from verify.errors import InputError


def main() -> int:
    """Compile what is not compiled yet; exit status 2 where no compiler does."""
    begin = time.monotonic()
    try:
        library_folder()
    except InputError as wrong:
        sys.stderr.write(f"{wrong}\n")
        return 2
    sys.stdout.write(f"Inner loops compiled in {time.monotonic() - begin:.0f} s.\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
