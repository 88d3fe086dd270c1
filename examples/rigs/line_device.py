"""A device on a serial line or a socket that answers a line with a voltage by a line with a displacement.

-> 1.250000       V
<- 0.998137       µm
"""

import socket
from dataclasses import dataclass
from typing import Protocol

from rig import Signal, library, paced

from torchpi.errors import RecordingError

MOST_WAIT_S = 1.0
"""For an answer."""


class Stream(Protocol):
    """What a serial port and the file of a socket have in common."""

    def write(self, data: bytes, /) -> int | None: ...
    def flush(self) -> None: ...
    def readline(self) -> bytes: ...


def serial_line(port: str, baudrate: int = 115_200) -> Stream:
    """A serial port. Needs `pip install pyserial`."""
    stream: Stream = library("serial", "pyserial").Serial(port, baudrate, timeout=MOST_WAIT_S)
    return stream


def socket_line(host: str, port: int) -> Stream:
    """A TCP connection."""
    connection = socket.create_connection((host, port), timeout=MOST_WAIT_S)
    connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    with connection:  # the file keeps it open
        return connection.makefile("rwb")


@dataclass(frozen=True)
class LineDevice:
    """One axis behind a line of text.

    Attributes:
        stream: From `serial_line` or `socket_line`.
        fs_hz: Sample rate: of what the line and the device bear.
        min_voltage_v, max_voltage_v: What may be put out.
    """

    stream: Stream
    fs_hz: float
    min_voltage_v: float = 0.0
    max_voltage_v: float = 10.0

    def play(self, u_v: Signal) -> Signal:
        return paced(self._exchange, u_v, self.fs_hz)

    def _exchange(self, voltage: float) -> float:
        self.stream.write(f"{voltage:.6f}\n".encode())
        self.stream.flush()
        try:
            answer = self.stream.readline()
        except TimeoutError:
            answer = b""  # as a serial port gives it
        try:
            return float(answer)
        except ValueError:
            found = f"the answer {answer!r}" if answer else f"no answer within {MOST_WAIT_S:g} s"
            raise RecordingError(f"line device: found {found}, expected a number in µm") from None
