"""What can go wrong on a line, to be switched on: by chance a message, or at an instant."""

from dataclasses import dataclass

import numpy as np

from verify.errors import InputError

PER_MESSAGE = ("noise", "half", "digit", "double", "lost", "split")
AT_INSTANTS = ("silence", "unplug", "reset", "jump", "alarm", "status")


@dataclass(frozen=True, slots=True)
class Faults:
    """Faults of one emulator; times count from its start."""

    noise: float = 0.0  # share of messages with bytes that nobody sent
    half: float = 0.0  # share that break off
    digit: float = 0.0  # share in which one digit is another, so that a checksum is wrong
    double: float = 0.0  # share sent twice
    lost: float = 0.0  # share not sent
    split: float = 0.0  # share sent in two pieces, 15 ms apart
    silence: tuple[float, float] | None = None  # s: from, for
    unplug: tuple[float, float] | None = None  # s: from, for; the port itself is gone
    reset: tuple[float, float] | None = None  # s; the device starts anew
    jump: tuple[float, float] | None = None  # s: when, and by how much its clock leaps
    alarm: tuple[float, float] | None = None  # s, number: an alarm stands from then on
    status: tuple[float, float] | None = None  # s, bits: set from then on

    def __bool__(self) -> bool:
        return self != Faults()


def parse(texts: list[str], known: frozenset[str]) -> Faults:
    """Read `noise=0.05`, `silence=10:3`, `reset=20` and the like.

    Args:
        texts: as the user wrote them.
        known: those that this device can have.

    Raises:
        InputError: not known, or no numbers.
    """
    values: dict[str, float | tuple[float, float]] = {}
    for text in texts:
        name, _, value = text.partition("=")
        if name not in known:
            expected = f"this device can have {', '.join(sorted(known))}"
            raise InputError("--fault", f'"{name}" is not known', expected, "Choose one of them.")
        try:
            numbers = [float(word) for word in value.split(":")]
        except ValueError:
            numbers = []
        if name in PER_MESSAGE and len(numbers) == 1 and 0 <= numbers[0] <= 1:
            values[name] = numbers[0]
        elif name in AT_INSTANTS and len(numbers) == (1 if name == "reset" else 2):
            values[name] = (numbers[0], numbers[-1])
        else:
            right = "a share from 0 to 1" if name in PER_MESSAGE else "AT:VALUE (reset: AT)"
            raise InputError("--fault", f'"{text}"', f"{right} is expected", "Mend it.")
    return Faults(**values)  # type: ignore[arg-type]  # the names say which kind


def during(span: tuple[float, float] | None, t: float) -> bool:
    """Whether t lies in a span given as (from, for)."""
    return span is not None and span[0] <= t < span[0] + span[1]


class Spoiler:
    """Spoils messages by chance."""

    PIECES_APART = 0.015  # s

    def __init__(self, faults: Faults, seed: int) -> None:
        self._faults, self._random = faults, np.random.default_rng(seed)

    def spoil(self, data: bytes) -> list[tuple[float, bytes]]:
        """What is sent in place of a message: pieces, each with its delay in s."""
        faults = self._faults
        if self._falls(faults.lost):
            return []
        if self._falls(faults.half):
            data = data[: int(self._random.integers(1, max(len(data) - 1, 2)))]
        if self._falls(faults.digit):
            data = self._other_digit(data)
        if self._falls(faults.noise):
            at = int(self._random.integers(0, len(data) + 1))
            data = data[:at] + self._random.bytes(int(self._random.integers(1, 9))) + data[at:]
        if self._falls(faults.split) and len(data) > 1:
            at = int(self._random.integers(1, len(data)))
            return [(0.0, data[:at]), (self.PIECES_APART, data[at:])]
        return [(0.0, data)] * (2 if self._falls(faults.double) else 1)

    def _falls(self, share: float) -> bool:
        return bool(share) and self._random.random() < share

    def _other_digit(self, data: bytes) -> bytes:
        places = [i for i, byte in enumerate(data) if chr(byte).isdigit()]
        if not places:
            return data
        at = int(self._random.choice(places))
        other = (data[at] - ord("0") + int(self._random.integers(1, 10))) % 10 + ord("0")
        return data[:at] + bytes([other]) + data[at + 1 :]
