"""Whether an arm has arrived: three signs at once, so that no single one is believed."""

from dataclasses import dataclass

import numpy as np

from verify.devices.melfa_lines import Position
from verify.records import Array

NEAR_DEG = 0.05  # five of the controller's last digits
READINGS = 3  # in a row, standing there
STALLED = 2.0  # s that it may stand elsewhere


@dataclass(slots=True)
class Arrival:
    """Follows one move."""

    target_deg: Array  # (joints,), the controller's own angles
    standing: int = 0  # readings in a row at the target, without speed
    running: bool = True  # as STATE last told
    stalled_since: float | None = None  # s: neither running nor at the target
    off_deg: float = float("inf")  # the worst joint's way that is left

    @property
    def arrived(self) -> bool:
        """Whether it stands at the target and the controller calls the move over."""
        return self.standing >= READINGS and not self.running

    @property
    def wants_state(self) -> bool:
        """Whether all that is missing is the controller's word that the move is over."""
        return self.running and self.standing > 0

    def see(self, position: Position, t: float) -> None:
        """Take a position, told at t s."""
        gap = np.abs(np.array(position.joints_deg) - self.target_deg)
        self.off_deg = float(np.max(gap))
        stands = position.speed == 0.0
        self.standing = self.standing + 1 if stands and self.off_deg <= NEAR_DEG else 0
        if self.standing or self.running or not stands:
            self.stalled_since = None
        elif self.stalled_since is None:
            self.stalled_since = t

    def stalled(self, t: float) -> bool:
        """Whether it has stood elsewhere for too long."""
        return self.stalled_since is not None and t - self.stalled_since > STALLED
