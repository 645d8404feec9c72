"""Where machine code is kept: never where it could not be written, and never in the way."""

import os
import subprocess
import sys
from pathlib import Path

# the package's own folder as of a user who may not write there
TELL = """
import importlib.util, os, pathlib
may, own = os.access, str(pathlib.Path(importlib.util.find_spec("verify").origin).parent)
os.access = lambda path, mode: str(path) != own and may(path, mode)
from verify import compiled
from verify.identification.kernel import turned
import numpy as np
print(compiled.KEPT, turned(np.zeros(3))[0, 0])
"""


def told(cache: Path) -> list[str]:
    surroundings = {k: v for k, v in os.environ.items() if k != "NUMBA_CACHE_DIR"}
    done = subprocess.run(
        [sys.executable, "-c", TELL],
        env=surroundings | {"XDG_CACHE_HOME": str(cache)},
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    return done.stdout.split()


def test_where_the_package_cannot_be_written_the_user_s_cache_serves(tmp_path: Path) -> None:
    assert told(tmp_path) == ["True", "1.0"]
    assert list((tmp_path / "verify").rglob("*.nbi"))


def test_what_cannot_be_kept_is_compiled_all_the_same(tmp_path: Path) -> None:
    (tmp_path / "cache").write_text("in the way")
    assert told(tmp_path / "cache") == ["False", "1.0"]
