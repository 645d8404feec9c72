"""Small scenarios that several tests start from."""

from typing import Any

import msgspec

from verify.sim.scenario import (
    EncodersTable,
    Led,
    MarkerTable,
    MultiJoint,
    Recording,
    Scenario,
)

HOME_DEG = [30.0, -62.0, 46.0, 8.0, -84.0, 24.0]


def scene(**changes: Any) -> Scenario:
    """A short multi-joint session of the 6R arm; keyword arguments replace whole tables."""
    plain = Scenario(
        format=1,
        robot="iust_6r",
        seed=5,
        motion=MultiJoint(home_deg=HOME_DEG, amplitude_deg=[10.0] * 6),
        recording=Recording(pairs=12, rate_hz=10.0),
        marker=MarkerTable(
            led=[
                Led(name="A", position_mm=(60.0, 5.0, 20.0)),
                Led(name="B", position_mm=(-50.0, 36.0, 12.0)),
                Led(name="C", position_mm=(-20.0, -55.0, 28.0)),
            ]
        ),
        encoders=EncodersTable(noise_deg=0.0),
    )
    return msgspec.structs.replace(plain, **changes)
