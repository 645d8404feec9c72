"""The origin of a calibration's results, and the units of their tables.

Four kinds of results begin their summary with it: calibrations from boards, interim checks,
registrations and identifications.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from verify.core.version import __version__

MM, UM, DEG = 1e3, 1e6, 180 / np.pi  # mm a metre, um a metre, degrees a radian
POSE_UNITS = np.array([MM] * 3 + [DEG] * 3)  # of a position and a rotation vector


@dataclass(frozen=True, slots=True)
class ResultsOrigin:
    """What results were made from."""

    source: str = ""  # name of the folder
    description: str = ""  # the user's words on it
    inputs: Mapping[str, str] = field(default_factory=dict)  # files that were read, with hashes
    warnings: tuple[str, ...] = ()  # sentences, on reading them

    def summary(self, kind: str) -> dict[str, Any]:
        """Begin the summary of results of one kind."""
        return {
            "format": 1,
            "kind": kind,
            "tool": {"name": "verify", "version": __version__},
            "source": {"path": self.source, "description": self.description},
            "inputs": dict(sorted(self.inputs.items())),
            "warnings": list(self.warnings),
        }
