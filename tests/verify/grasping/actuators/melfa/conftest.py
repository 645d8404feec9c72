import pytest


@pytest.fixture(autouse=True)
def fast_servo(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("verify.simulation.emulators.arm.SERVO_TIME", 0.05)
