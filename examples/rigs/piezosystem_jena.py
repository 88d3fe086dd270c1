"""Amplifiers of piezosystem jena of the d-Drive family, by their commands: slow, and nothing else is needed.

Needs Python 3.12 and `pip install psj-lib`. Each sample is two commands: some 100 Hz at most. For more,
drive the modulation input from an analog output and read the monitor output, as `ni_daqmx.py` does.
"""

import asyncio
from dataclasses import dataclass
from typing import Any

from rig import Signal, library, paced


@dataclass(frozen=True)
class PiezosystemJena:
    """One channel without closed loop, whose actuator has a sensor.

    Attributes:
        port: The serial port, such as `COM3` or `/dev/ttyUSB0`.
        fs_hz: Sample rate.
        channel: Its number.
        min_voltage_v, max_voltage_v: What may be put out.
    """

    port: str
    fs_hz: float
    channel: int = 0
    min_voltage_v: float = -20.0
    max_voltage_v: float = 130.0

    def play(self, u_v: Signal) -> Signal:
        psj = library("psj_lib", "psj-lib")
        device = psj.DDriveDevice(psj.TransportType.SERIAL, self.port)
        with asyncio.Runner() as runner:
            runner.run(device.connect())
            try:
                channel = device.channels[self.channel]
                runner.run(channel.closed_loop_controller.set(False))
                return paced(lambda voltage: runner.run(exchange(channel, voltage)), u_v, self.fs_hz)
            finally:
                runner.run(device.close())


async def exchange(channel: Any, voltage: float) -> float:
    await channel.setpoint.set(voltage)
    return float(await channel.position.get())
