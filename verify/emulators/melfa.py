"""A MELFA controller that speaks the R3 line protocol: the line, rights and refusals.

Its identity says that it is emulated: the notice, which on a controller is its maker's, holds a
digest of the name under which the line was opened. Who draws that name by chance can tell.
"""

import hashlib
import re
from dataclasses import dataclass

import numpy as np

from verify.emulators.melfa_arm import MelfaArm
from verify.emulators.server import Message

LONGEST = 255  # bytes of a command
QUIET = 0.01  # s
_COMMAND = re.compile(r"(?:[0-3]?;[0-9]{0,2};)?([A-Z].*)", re.DOTALL)
_NAME = re.compile(
    r"OPSTSRD|GJPOSF|GPPOSF|ERRORMES|EXEC2=|SLOTINIT|PRGLOAD|BREAKONF|RSTALRM|RSTPRG|CNTLOFF"
    r"|CNTLON|SRVENC|SRVDRP|SRVSPD|SRVOFF|SRVON|STPSIG|DSTATE|JPOSF|PPOSF|CSTOP|CLOSE|ETEMP|EMISS"
    r"|ERROR|STATE|HNDOFF|HNDON|MOVSP|OPEN|OVRD|EXEC|STOP|PAR|RUN|JOG|HOT"
)
# starred in the manual: they need the operation right
STARRED = frozenset(
    {"SRVON", "SRVOFF", "EXEC", "EXEC2=", "RUN", "PRGLOAD", "MOVSP", "JOG"}
)  # fmt: skip
MOVING = frozenset({"EXEC", "EXEC2=", "MOVSP", "JOG", "RUN"})  # these need the servo, too


@dataclass(frozen=True, slots=True)
class ControllerOptions:
    """What kind of controller it is, and how it answers."""

    robot_type: str = "RV-3SD"
    axes: int = 6  # that JPOSF tells: 6 to 8
    end: bytes = b"\r"  # of an answer
    latency: float = 0.008  # s
    jitter: float = 0.004  # s, added, uniform
    need_open: bool = True  # QeR6500 before OPEN
    least_pause: float = 0.0  # s: asked sooner while the arm moves, it refuses with 6130


class MelfaEngine:
    """The line server.

    Args:
        arm: what the controller controls.
        options: how it answers.
        seed: of the jitter.
    """

    def __init__(self, arm: MelfaArm, options: ControllerOptions, seed: int = 0) -> None:
        self.log: list[str] = []  # every command received, without robot and slot
        self.arm, self._options = arm, options
        self._random = np.random.default_rng(seed)
        self._buffer = b""
        self._open = False
        self._heard = 0.0  # s: when the last byte came
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

    def step(self, t: float, received: bytes) -> list[Message]:
        """Answer what has come; without a terminator, a short silence ends a command."""
        if received:
            self._buffer, self._heard = self._buffer + received, t
        *parts, self._buffer = re.split(rb"[\r\n\0]+", self._buffer)
        if self._buffer and t - self._heard > QUIET:
            parts.append(self._buffer)
            self._buffer = b""
        messages = []
        for part in filter(None, parts):
            delay = self._options.latency + self._random.uniform(0.0, self._options.jitter)
            answer = self._answer(part, t)
            self._free = max(t, self._free) + delay
            messages.append(Message(self._free, answer.encode("ascii") + self._options.end))
        return messages

    def _answer(self, command: bytes, t: float) -> str:
        self.arm.go_on(t)
        match = _COMMAND.fullmatch(command.decode("ascii", errors="replace"))
        text = match[1] if match else ""
        self.log.append(text)
        name = _NAME.match(text)
        if len(command) > LONGEST:
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
        if not self._open and name != "OPEN" and self._options.need_open:
            return 6500
        hasty = t - self._free < self._options.least_pause
        if self._options.least_pause and hasty and self.arm.moving:
            return 6130
        if (name in STARRED) and not self.arm.right:
            return 6020
        if name in MOVING and self.arm.alarm:
            return 5600
        return 2000 if name in MOVING and not self.arm.servo_on else 0

    def _obey(self, name: str, argument: str, t: float) -> str | int:
        """Do it: the answer's data, or the number of the error."""
        if name == "OPEN":
            self._open = True
            return self._identity(argument.removeprefix("=").partition(";")[0])
        if name == "CLOSE":
            self._open = False
            return ""
        if name == "OPSTSRD":
            return "ENET;10001;1" if argument in ("1", "2", "3") else 3110
        told = self.arm.told(name, argument, t, self._options.axes)
        return told if told is not None else self.arm.obey(name, argument, t)

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
