"""A MELFA controller: the R3 line protocol with its rights and refusals, and the Mxt packets.

Its identity marks it as emulated: the notice, which on a controller is its maker's, holds a
digest of the name under which the line was opened. A client with a random name can recognise it.
"""

import hashlib
import re
import struct
from dataclasses import dataclass

import numpy as np

from verify.simulation.emulators.arm import SERVO_LAG, MelfaArm
from verify.simulation.emulators.server import EmulatorEngine, TimedMessage
from verify.simulation.emulators.trajectory import EmulatedTrajectory

MAX_COMMAND_BYTES = 255  # bytes of a command
COMMAND_TIMEOUT = 0.01  # s
_COMMAND = re.compile(r"(?:[0-3]?;[0-9]{0,2};)?([A-Z].*)", re.DOTALL)
_NAME = re.compile(
    r"OPSTSRD|GJPOSF|GPPOSF|ERRORMES|EXEC2=|SLOTINIT|PRGLOAD|BREAKONF|RSTALRM|RSTPRG|CNTLOFF"
    r"|CNTLON|SRVENC|SRVDRP|SRVSPD|SRVOFF|SRVON|STPSIG|DSTATE|JPOSF|PPOSF|CSTOP|CLOSE|ETEMP|EMISS"
    r"|ERROR|STATE|HNDOFF|HNDON|MOVSP|OPEN|OVRD|EXEC|STOP|PAR|RUN|JOG|HOT"
)
# starred in the manual: they need the operation right
RIGHTS_COMMANDS = frozenset({"SRVON", "SRVOFF", "EXEC", "EXEC2=", "RUN", "PRGLOAD", "MOVSP", "JOG"})
SERVO_COMMANDS = frozenset({"EXEC", "EXEC2=", "MOVSP", "JOG", "RUN"})  # these need the servo, too


@dataclass(frozen=True, slots=True)
class ControllerOptions:
    """What kind of controller it is, and how it answers."""

    robot_type: str = "RV-3SD"
    axes: int = 6  # that JPOSF tells: 6 to 8
    end: bytes = b"\r"  # of an answer
    latency: float = 0.008  # s
    jitter: float = 0.004  # s, added, uniform
    least_pause: float = 0.0  # s: asked sooner while the arm moves, it refuses with 6130


class MelfaEngine(EmulatorEngine):
    """The line server."""

    def __init__(self, arm: MelfaArm, options: ControllerOptions, seed: int = 0) -> None:
        self.log: list[str] = []  # every command received, without robot and slot
        self.arm, self._options = arm, options
        self._random = np.random.default_rng(seed)
        self._buffer = b""
        self._open = False
        self._received_at = 0.0  # s: when the last byte came
        self._free = 0.0  # s: when the last answer was given

    def greet(self, t: float) -> None:
        """Take a caller: the line is closed until OPEN."""
        self._buffer, self._open, self._free = b"", False, t - self._options.least_pause

    def reset(self, t: float) -> None:
        """Start anew: no line, no right, no servo."""
        self.greet(t)
        self.arm.restart(t)

    def afflict(self, fault: str, value: float) -> None:
        """Raise an alarm."""
        if fault == "alarm":
            self.arm.raise_alarm(int(value))

    def step(self, t: float, received: bytes) -> list[TimedMessage]:
        """Answer what has come; without a terminator, a short silence ends a command."""
        if received:
            self._buffer, self._received_at = self._buffer + received, t
        *parts, self._buffer = re.split(rb"[\r\n\0]+", self._buffer)
        if self._buffer and t - self._received_at > COMMAND_TIMEOUT:
            parts.append(self._buffer)
            self._buffer = b""
        messages = []
        for part in filter(None, parts):
            delay = self._options.latency + self._random.uniform(0.0, self._options.jitter)
            answer = self._answer(part, t)
            self._free = max(t, self._free) + delay
            messages.append(TimedMessage(self._free, answer.encode("ascii") + self._options.end))
        return messages

    def _answer(self, command: bytes, t: float) -> str:
        self.arm.go_on(t)
        match = _COMMAND.fullmatch(command.decode("ascii", errors="replace"))
        text = match[1] if match else ""
        self.log.append(text)
        name = _NAME.match(text)
        if len(command) > MAX_COMMAND_BYTES:
            return self._refusal(6080)
        if match is None:
            return self._refusal(4220)
        if name is None or name[0] == "BREAKONF":
            return self._refusal(6010)
        refusal = self._refused(name[0], t)
        if refusal:
            return self._refusal(refusal)
        data = self._obey(name[0], text[name.end() :], t)
        return self._refusal(data) if isinstance(data, int) else f"Qo{self._letter('K')}{data}"

    def _refused(self, name: str, t: float) -> int:
        if not self._open and name != "OPEN":
            return 6500
        hasty = t - self._free < self._options.least_pause
        if self._options.least_pause and hasty and self.arm.moving:
            return 6130
        if (name in RIGHTS_COMMANDS) and not self.arm.right:
            return 6020
        if name in SERVO_COMMANDS and self.arm.alarm:
            return 5600
        return 2000 if name in SERVO_COMMANDS and not self.arm.servo_on else 0

    def _obey(self, name: str, argument: str, t: float) -> str | int:
        """Do it: the answer's data, or the number of the error."""
        if name == "OPEN":
            self._open = True
            return self._identity(argument.removeprefix("=").partition(";")[0])
        if name == "CLOSE":
            self._open = False
            return ""
        return self.arm.obey(name, argument, t, self._options.axes)

    def _identity(self, client: str) -> str:
        kind = self._options.robot_type
        digest = hashlib.sha256(f"verify emulate {client}".encode()).hexdigest()[:16]
        return (
            f"3F;3F;7,0;3,5,A,1E,32,46,64;MB5;PRM;{kind};CRn-7xx;MELFA;09-01-20;Ver.N8a;ENG;"
            f"EMULATED {digest};1;1;8;"
        )

    def _refusal(self, number: int) -> str:
        return f"Qe{self._letter('R')}{number:04d}"

    def _letter(self, letter: str) -> str:
        return letter.lower() if self.arm.alarm else letter


CYCLE = 64 / 9 * 1e-3  # s
TIMEOUT = 0.5  # s without a packet: error 7820, the stream ends (parameter MXTTOUT)
PULSES_PER_RADIAN = 2_000_000.0  # gears and encoders are not public
CYCLE_MODULUS = 1 << 32
COMMANDED, COMMANDED_PULSES, MEASURED, MEASURED_PULSES = 2, 3, 8, 9
LAYOUT = struct.Struct("<HHHH40sHHHHHHIHH40sHH40sHH40s")


class RealtimeEngine(EmulatorEngine):
    """Once asked, answers every cycle while packets keep coming."""

    def __init__(self, trajectory: EmulatedTrajectory, joints: int) -> None:
        self.log: list[bytes] = []  # first bytes of every packet received
        self._trajectory, self._joints = trajectory, joints
        self._wanted = (0, 0, 0, 0)
        self._received_at: float | None = None
        self._next = 0.0
        self._count = 0
        self._missed = 0

    def greet(self, t: float) -> None:
        """Take the next caller like the last."""

    def reset(self, t: float) -> None:
        """Start the cycle counter anew."""
        self._count, self._missed, self._next = 0, 0, t

    def afflict(self, fault: str, value: float) -> None:
        """Let the cycle counter leap by so many s."""
        if fault == "jump":
            self._count = (self._count + round(value / CYCLE)) % CYCLE_MODULUS

    def step(self, t: float, received: bytes) -> list[TimedMessage]:
        """Count cycles; say one packet in each."""
        if len(received) == LAYOUT.size:
            self._hear(received, t)
        messages = []
        while self._next <= t:
            self._next += CYCLE
            self._count = (self._count + 1) % CYCLE_MODULUS
            if self._received_at is None:
                continue
            if t - self._received_at > TIMEOUT:
                self._received_at = None
                continue
            if t - self._received_at > 1.5 * CYCLE:
                self._missed = (self._missed + 1) % (1 << 16)
            messages.append(TimedMessage(t, self._packet(t)))
        return messages

    def _hear(self, data: bytes, t: float) -> None:
        self.log.append(data[:8])
        fields = LAYOUT.unpack(data)
        if fields[0] == 255:
            self._received_at = None
            return
        self._wanted = (fields[2], fields[12], fields[15], fields[18])
        if self._received_at is None:
            self._missed = 0
        self._received_at = t

    def _packet(self, t: float) -> bytes:
        blocks = [(kind, self._block(kind, t)) for kind in self._wanted]
        (first, data), *others = blocks
        rest = [part for kind, block in others for part in (kind, 0, block)]
        return LAYOUT.pack(0, 0, first, 0, data, 0, 0, 0, 0, 0, self._missed, self._count, *rest)

    def _block(self, kind: int, t: float) -> bytes:
        lag = SERVO_LAG if kind in (MEASURED, MEASURED_PULSES) else 0.0
        joints = np.zeros(8)
        joints[: self._joints] = self._trajectory(max(t - lag, 0.0))
        if kind in (COMMANDED, MEASURED):
            return joints.astype("<f4").tobytes().ljust(40, b"\0")
        if kind in (COMMANDED_PULSES, MEASURED_PULSES):
            return np.rint(joints * PULSES_PER_RADIAN).astype("<i4").tobytes().ljust(40, b"\0")
        return bytes(40)
