"""NI-DAQmx: an analog output drives the amplifier, an analog input reads the sensor, on one clock.

Needs NI's driver, and `pip install nidaqmx` (https://nidaqmx-python.readthedocs.io).
"""

from dataclasses import dataclass

import numpy as np
from rig import Signal, library

MOST_LATE_S = 10.0


@dataclass(frozen=True)
class NiDaqmx:
    """One axis on a multifunction device.

    Both tasks run on the sample clock of the input, so that a reading is taken at the instant at which the
    next voltage is put out: it is the answer to the voltages before. A fit finds this sample of delay.

    Attributes:
        output: Channel of the voltage, such as `Dev1/ao0`.
        sensor: Channel of the sensor, such as `Dev1/ai0`.
        fs_hz: Sample rate.
        um_per_v: Displacement that a volt of the sensor stands for.
        min_voltage_v, max_voltage_v: Of the output.
        sensor_range_v: Largest voltage of the sensor, of either sign.
    """

    output: str
    sensor: str
    fs_hz: float
    um_per_v: float
    min_voltage_v: float = 0.0
    max_voltage_v: float = 10.0
    sensor_range_v: float = 10.0

    def play(self, u_v: Signal) -> Signal:
        nidaqmx = library("nidaqmx", "nidaqmx")
        clock = f"/{self.sensor.split('/')[0]}/ai/SampleClock"
        last_s = len(u_v) / self.fs_hz + MOST_LATE_S
        with nidaqmx.Task() as drive, nidaqmx.Task() as sensor:
            sensor.ai_channels.add_ai_voltage_chan(
                self.sensor, min_val=-self.sensor_range_v, max_val=self.sensor_range_v
            )
            drive.ao_channels.add_ao_voltage_chan(
                self.output, min_val=self.min_voltage_v, max_val=self.max_voltage_v
            )
            sensor.timing.cfg_samp_clk_timing(self.fs_hz, samps_per_chan=len(u_v))
            drive.timing.cfg_samp_clk_timing(self.fs_hz, source=clock, samps_per_chan=len(u_v))
            drive.write(u_v, auto_start=False)
            drive.start()  # waits for the clock, which the other brings
            sensor.start()
            readings_v = sensor.read(number_of_samples_per_channel=len(u_v), timeout=last_s)
            drive.wait_until_done(timeout=last_s)
        return self.um_per_v * np.asarray(readings_v, dtype=np.float64)
