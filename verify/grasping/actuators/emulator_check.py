"""Prove that the other end of a port is an emulator, whose motion nobody has to confirm.

The controller is opened under a random name; the emulator puts a digest of that name into its
identity, which no maker's controller computes and no echo or stale answer can hold. The gripper is
asked for its device identification (Modbus, function 43/14), which names its vendor. Whatever is
silent, late, garbled or refused is no emulator.
"""

import hashlib
import secrets
import time
from collections.abc import Callable

from pymodbus.exceptions import ModbusException
from pymodbus.framer import FramerRTU
from pymodbus.pdu import DecodePDU
from pymodbus.pdu.mei_message import ReadDeviceInformationRequest, ReadDeviceInformationResponse

from verify.devices.melfa.protocol import ReadCommand
from verify.devices.ports import Port

TIMEOUT = 1.0  # s for an answer
POLL_PERIOD = 0.05  # s between two checks of the clock
MAX_ANSWER_BYTES = 1024  # bytes of an answer
VENDOR, PRODUCT = b"verify", b"emulated gripper"  # objects 0 and 1 of the identification

PortCheck = Callable[[Port], bool]


class EmulatorPortOpener:
    """Opens a port to an emulator of this program, and to nothing else, however often."""

    def __init__(self, open_port: Callable[[], Port], asks: PortCheck) -> None:
        self._open_port, self._asks = open_port, asks
        self._kept: Port | None = None  # already asked

    def there(self) -> bool:
        """Ask; the port stays open for the first caller where the answer is yes."""
        try:
            self._kept = self()
        except OSError:
            return False
        return True

    def __call__(self) -> Port:
        """Open the port.

        Raises:
            OSError: it cannot be opened, or the other end does not prove to be an emulator.
        """
        if self._kept is not None:
            port, self._kept = self._kept, None
            return port
        port = self._open_port()
        try:
            if not self._asks(port):
                raise ConnectionRefusedError("the other end is not an emulator of this program")
        except OSError:
            port.close()
            raise
        return port

    def close(self) -> None:
        """Close a port that nobody has called for."""
        if self._kept is not None:
            self._kept.close()
        self._kept = None


def is_emulated_melfa(port: Port, terminator: bytes = b"\r") -> bool:
    """Open the controller's line under a random name, and search its answer for the name's digest.

    Nothing but OPEN and CLOSE is sent, which only read.

    Raises:
        OSError: the line is gone.
    """
    name = secrets.token_hex(8)
    port.send(ReadCommand("OPEN", f"={name}").encoded(terminator))
    digest = hashlib.sha256(f"verify emulate {name}".encode()).hexdigest()[:16]
    proof = f";EMULATED {digest};".encode()
    if _wait_for_answer(port, lambda data: proof in data):
        return True
    port.send(ReadCommand("CLOSE").encoded(terminator))
    return False


def is_emulated_gripper(port: Port, slave: int = 9) -> bool:
    """Ask a Modbus RTU slave who made it; OSError: the line is gone."""
    framer = FramerRTU(DecodePDU(is_server=False))
    port.send(framer.buildFrame(ReadDeviceInformationRequest(read_code=1, dev_id=slave)))

    def named(data: bytes) -> bool:
        try:
            _, answer = framer.handleFrame(data, slave, 0)
        except (ModbusException, IndexError):
            return False
        return (
            isinstance(answer, ReadDeviceInformationResponse)
            and answer.information.get(0) == VENDOR
            and answer.information.get(1) == PRODUCT
        )

    return _wait_for_answer(port, named)


def _wait_for_answer(port: Port, wanted: Callable[[bytes], bool]) -> bool:
    """Listen until what is wanted has come, for at most TIMEOUT."""
    data, end = b"", time.monotonic() + TIMEOUT
    while time.monotonic() < end:
        if port.wait(POLL_PERIOD):
            data = (data + port.take())[-MAX_ANSWER_BYTES:]
            if wanted(data):
                return True
    return False
