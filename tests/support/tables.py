"""Tables as controllers and instruments write them, and `verify convert` on them."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from tests.support.command import Outcome, verify
from verify.core.records import Array

ROWS = 300
T = 0.012 * np.arange(ROWS)
Q = np.deg2rad(70) * np.sin(np.outer(T, [1.0, 0.8, 0.6, 1.1, 1.3, 0.9])) + 0.1  # rad
ALL_JOINTS = [f"q{j}_deg" for j in range(1, 7)]


def write_table(
    path: Path, names: Sequence[str], rows: Array, separator: str = ",", comma: bool = False,
    before: str = "", encoding: str = "utf-8", end: str = "",
) -> Path:  # fmt: skip
    lines = [separator.join(names) + end]
    for row in rows:
        cells = [f"{value:.9f}" for value in row]
        lines.append(separator.join(c.replace(".", ",") if comma else c for c in cells) + end)
    path.write_text(before + "\n".join([*lines, ""]), encoding=encoding)
    return path


def convert(source: Path, out: Path, *options: str | Path) -> Outcome:
    return verify("convert", source, "-o", out, *options)


def joints_of(folder: Path) -> Array:
    return np.deg2rad(pd.read_csv(folder / "encoders.csv")[ALL_JOINTS].to_numpy())
