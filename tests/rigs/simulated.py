"""Stand-ins for hardware: the parts of the vendors' libraries that rigs use, on a simulated stage."""

import socketserver
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest

from torchpi import Stage

sys.path.insert(0, str(Path(__file__).parents[2] / "examples" / "rigs"))


class Axis:
    """The built-in stage, which holds each voltage for `held` of its own samples, 10,000 per second."""

    def __init__(self, held: int = 1) -> None:
        self.held = held
        self.stream = Stage.from_yaml("default").stream(compiled=False)
        self.played: list[float] = []
        self.reading = 0.0

    def step(self, voltage: float) -> float:
        self.played.append(voltage)
        for _ in range(self.held):
            self.reading = self.stream.step(voltage)[1]
        return self.reading


class Clock:
    """A clock that advances during each sleep, and by `tick_s` each time it is read."""

    def __init__(self, tick_s: float = 0.0) -> None:
        self.now_s, self.tick_s = 0.0, tick_s

    def perf_counter(self) -> float:
        self.now_s += self.tick_s
        return self.now_s

    def sleep(self, seconds: float) -> None:
        self.now_s += seconds


def install(monkeypatch: pytest.MonkeyPatch, name: str, **members: Any) -> None:
    module = ModuleType(name)
    vars(module).update(members)
    monkeypatch.setitem(sys.modules, name, module)


class Nidaqmx:
    """`nidaqmx.Task`: one task drives and one reads, and the sample clock of the latter times both."""

    def __init__(self, axis: Axis) -> None:
        self.axis, self.tasks = axis, []

    def Task(self) -> "NidaqmxTask":
        self.tasks.append(NidaqmxTask(self))
        return self.tasks[-1]


class NidaqmxTask:
    def __init__(self, device: Nidaqmx) -> None:
        self.device, self.started = device, False
        self.ai_channels = SimpleNamespace(add_ai_voltage_chan=self.add_channel)
        self.ao_channels = SimpleNamespace(add_ao_voltage_chan=self.add_channel)
        self.timing = SimpleNamespace(cfg_samp_clk_timing=self.clocked)

    def __enter__(self) -> "NidaqmxTask":
        return self

    def __exit__(self, *_: object) -> None:
        self.device.tasks.remove(self)

    def add_channel(self, physical_channel: str, *, min_val: float, max_val: float) -> None:
        self.channel, self.limits = physical_channel, (min_val, max_val)

    def clocked(self, rate: float, source: str = "", *, samps_per_chan: int) -> None:
        self.source, self.samples = source, samps_per_chan

    def write(self, data: np.ndarray, auto_start: bool) -> None:
        assert len(data) == self.samples and not auto_start
        assert self.limits[0] <= data.min() and data.max() <= self.limits[1]
        self.data = data

    def start(self) -> None:
        self.started = True

    def read(self, number_of_samples_per_channel: int, timeout: float) -> list[float]:
        (drive,) = (task for task in self.device.tasks if task is not self)
        assert self.started and drive.started and drive.source == "/Dev1/ai/SampleClock"
        assert number_of_samples_per_channel == self.samples == drive.samples < 1e4 * timeout
        readings = []
        for voltage in drive.data.tolist():
            readings.append(self.device.axis.reading)  # at the clock edge at which the next voltage is output
            self.device.axis.step(voltage)
        return readings

    def wait_until_done(self, timeout: float) -> None:
        assert self.started


class GcsDevice:
    """A connected `pipython.GCSDevice`: commands of a wave generator and a data recorder."""

    def __init__(self, axis: Axis, servo_s: float) -> None:
        self.axis, self.servo_s = axis, servo_s
        self.points: list[float] = []
        self.set: dict[str, tuple[Any, ...]] = {}
        self.bufstate: bool | float = False

    def __getattr__(self, command: str) -> Any:
        if command not in ("SVO", "WTR", "RTR", "WSL", "WGC", "DRC"):
            raise AttributeError(command)
        return lambda *values: self.set.update({command: values})

    def qSPA(self, items: str, params: int) -> dict[str, dict[int, float]]:
        return {items: {params: self.servo_s}}

    def WAV_PNT(
        self, table: int, firstpoint: int, numpoints: int, append: str, wavepoint: list[float]
    ) -> None:
        self.points = wavepoint if append == "X" else self.points + wavepoint
        assert firstpoint + numpoints == len(self.points) + 1

    def WGO(self, wavegens: int, mode: int) -> None:
        if mode:
            assert self.set["SVO"] == ("1", False) and self.set["DRC"] == (1, "1", 2)
            assert self.set["WTR"] == (1, *self.set["RTR"], 0) and self.set["WGC"] == self.set["WSL"] == (
                1,
                1,
            )
            self.bufdata = [[self.axis.step(voltage) for voltage in self.points]]

    def qDRR(self, tables: int, offset: int, numvalues: int) -> None:
        assert (tables, offset, numvalues) == (1, 1, len(self.bufdata[0]))
        self.bufstate = True


class Pitools:
    """`pipython.pitools`."""

    @staticmethod
    def writewavepoints(pidevice: GcsDevice, wavetable: int, wavepoints: list[float], bunchsize: int) -> None:
        for k in range(0, len(wavepoints), bunchsize):
            bunch = wavepoints[k : k + bunchsize]
            pidevice.WAV_PNT(wavetable, k + 1, len(bunch), "&" if k else "X", bunch)

    @staticmethod
    def waitonwavegen(pidevice: GcsDevice, wavegens: int, timeout: float) -> None:
        assert timeout > len(pidevice.points) * pidevice.servo_s


class PsjLib:
    """`psj_lib`, with an amplifier that has one channel, 0."""

    TransportType = SimpleNamespace(SERIAL="Serial")

    def __init__(self, axis: Axis) -> None:
        self.axis = axis

    def DDriveDevice(self, transport: str, identifier: str) -> "PsjLib":
        assert (transport, identifier) == ("Serial", "COM3")
        return self

    async def connect(self) -> None:
        setpoint, position = SimpleNamespace(set=self.move), SimpleNamespace(get=self.position)
        loop = SimpleNamespace(set=self.close_loop)
        self.channels = {
            0: SimpleNamespace(setpoint=setpoint, position=position, closed_loop_controller=loop)
        }

    async def close(self) -> None:
        self.channels = {}

    async def close_loop(self, enabled: bool) -> None:
        assert not enabled

    async def move(self, value: float) -> None:
        self.axis.step(value)

    async def position(self) -> float:
        return self.axis.reading


class SerialPort:
    """`serial.Serial`, with a device on the other end."""

    def __init__(self, axis: Axis) -> None:
        self.axis, self.answers = axis, [b""]

    def Serial(self, port: str, baudrate: int, timeout: float) -> "SerialPort":
        return self

    def write(self, data: bytes) -> int:
        self.answers.append(answer(self.axis, data))
        return len(data)

    def flush(self) -> None: ...

    def readline(self) -> bytes:
        return self.answers.pop()


def answer(axis: Axis, line: bytes) -> bytes:
    return f"{axis.step(float(line))!r}\n".encode()


@contextmanager
def listening(axis: Axis) -> Iterator[int]:
    """A device that listens on a port of this machine."""

    class Line(socketserver.StreamRequestHandler):
        def handle(self) -> None:
            for line in self.rfile:
                self.wfile.write(answer(axis, line))

    with socketserver.TCPServer(("127.0.0.1", 0), Line) as server:
        thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01})
        thread.start()
        yield server.server_address[1]
        server.shutdown()
        thread.join()
