"""Rigs: each plays a given voltage on a simulated backend, and a compensated scan takes ten lines."""

import re
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.rigs import simulated
from tests.rigs.simulated import Axis, GcsDevice, install
from torchpi.errors import ConfigError, RecordingError

from line_device import LineDevice, serial_line, socket_line  # isort: skip
from ni_daqmx import NiDaqmx  # isort: skip
from pi_gcs import PiGcs  # isort: skip
from piezosystem_jena import PiezosystemJena  # isort: skip
from rig import SWEEP_S, Rig, record, scan, swept  # isort: skip

PAGE = (Path(__file__).parents[2] / "docs" / "rigs.md").read_text(encoding="utf-8")
FS_HZ, SLOW_HZ = 10_000.0, 500.0
U = 5 - 5 * np.cos(2 * np.pi * np.arange(100) / 100)
RIGS = ("ni_daqmx", "pi_gcs", "piezosystem_jena", "serial", "socket")


@pytest.fixture(autouse=True)
def quick_clock(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("rig.time", simulated.Clock())


@pytest.fixture
def axis(request: pytest.FixtureRequest) -> Axis:
    name = request.node.callspec.params.get("rig") if hasattr(request.node, "callspec") else None
    return Axis(held=1 if name in (None, "ni_daqmx", "pi_gcs") else round(FS_HZ / SLOW_HZ))


@pytest.fixture
def rig(request: pytest.FixtureRequest, axis: Axis, monkeypatch: pytest.MonkeyPatch) -> Iterator[Rig]:
    """The rig of this name, with its vendor's library replaced by a stand-in."""
    match request.param:
        case "ni_daqmx":
            install(monkeypatch, "nidaqmx", Task=simulated.Nidaqmx(axis).Task)
            yield NiDaqmx("Dev1/ao0", "Dev1/ai0", fs_hz=FS_HZ, um_per_v=1.0)
        case "pi_gcs":
            install(monkeypatch, "pipython")
            install(monkeypatch, "pipython.pitools", **vars(simulated.Pitools))
            yield PiGcs(GcsDevice(axis, 5e-5), FS_HZ)
        case "piezosystem_jena":
            backend = simulated.PsjLib(axis)
            install(
                monkeypatch, "psj_lib", DDriveDevice=backend.DDriveDevice, TransportType=backend.TransportType
            )
            yield PiezosystemJena("COM3", fs_hz=SLOW_HZ)
        case "serial":
            install(monkeypatch, "serial", Serial=simulated.SerialPort(axis).Serial)
            yield LineDevice(serial_line("COM1"), fs_hz=SLOW_HZ)
        case _:
            with simulated.listening(axis) as port:
                with socket_line("127.0.0.1", port) as stream:
                    yield LineDevice(stream, fs_hz=SLOW_HZ)


@pytest.mark.parametrize("rig", RIGS, indirect=True)
def test_a_rig_plays_the_given_voltage_and_returns_the_sensor_readings(rig: Rig, axis: Axis) -> None:
    y, stream = rig.play(U), Axis(axis.held)
    expected = np.array([stream.step(voltage) for voltage in axis.played])
    assert np.allclose(axis.played, U, rtol=0, atol=1e-6)
    late = 1 if isinstance(rig, NiDaqmx) else 0
    assert np.array_equal(y[late:], expected[: len(expected) - late])


@pytest.mark.parametrize("rig", RIGS, indirect=True)
def test_a_recording_begins_with_a_sweep_from_rest(rig: Rig, axis: Axis) -> None:
    record(rig, U, "before")
    recording = record(rig, U, "slow")
    sweep = round(SWEEP_S * rig.fs_hz)
    assert (recording.name, recording.fs_hz, len(recording.y)) == ("slow", rig.fs_hz, sweep + len(U))
    assert np.array_equal(recording.u[sweep:], U) and recording.u[:sweep].max() > 0.99 * U.max()
    assert abs(recording.y[0]) < 0.02


def test_a_sweep_goes_to_both_extremes_and_back_to_zero() -> None:
    signal = np.array([1.0, -2.0, 3.0])
    (sweep, last) = np.split(swept(signal, 1e4), [-3])
    assert np.array_equal(last, signal) and len(sweep) == SWEEP_S * 1e4
    assert (sweep.min(), sweep.max()) == pytest.approx((-2.0, 3.0), abs=1e-4)
    assert sweep[0] == 0 and abs(sweep[-1]) < 1e-4


@pytest.mark.parametrize("rig", RIGS, indirect=True)
@pytest.mark.parametrize(("bad", "found"), [(140.0, "140"), (-25.0, "-25"), (np.nan, "nan"), (np.inf, "inf")])
def test_a_voltage_outside_its_limits_is_not_played(bad: float, found: str, rig: Rig, axis: Axis) -> None:
    u = U.copy()
    u[7] = bad
    with pytest.raises(ConfigError, match=rf"voltage, index 7: found {found} V, expected .* V; nothing was"):
        record(rig, u)
    with pytest.raises(ConfigError, match=r"found the shape \(1, 100\), expected \(time,\)"):
        record(rig, U[None])
    assert axis.played == []


@pytest.mark.parametrize(
    ("rig", "module"),
    [
        (NiDaqmx("Dev1/ao0", "Dev1/ai0", FS_HZ, 1.0), "nidaqmx"),
        (PiGcs(None, FS_HZ), "pipython"),
        (PiezosystemJena("COM3", 100.0), "psj-lib"),
    ],
)
def test_a_missing_library_is_reported_with_its_install_command(
    rig: Rig, module: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("nidaqmx", "pipython", "psj_lib"):
        monkeypatch.setitem(sys.modules, name, None)
    with pytest.raises(ConfigError, match=f"pip install {module}$"):
        rig.play(U)


def test_a_rate_that_the_servo_does_not_offer_is_refused(monkeypatch: pytest.MonkeyPatch, axis: Axis) -> None:
    install(monkeypatch, "pipython")
    install(monkeypatch, "pipython.pitools", **vars(simulated.Pitools))
    with pytest.raises(
        ConfigError, match=r"found 7000 Hz, expected the servo's 20000 Hz .* such as 6666\.67 Hz"
    ):
        PiGcs(GcsDevice(axis, 5e-5), 7000.0).play(U)


class Answering:
    """A stream whose device answers with the given function."""

    def __init__(self, readline: Callable[[], bytes]) -> None:
        self.readline = readline

    def write(self, data: bytes) -> int:
        return len(data)

    def flush(self) -> None: ...


def silent() -> bytes:
    raise TimeoutError


@pytest.mark.parametrize(
    ("readline", "found"),
    [
        (lambda: b"ERR 3\n", r"found the answer b'ERR 3\\n', expected a number in µm"),
        (lambda: b"", "found no answer within 1 s"),
        (silent, "found no answer within 1 s"),
    ],
)
def test_an_answer_that_is_not_a_number_ends_the_scan(readline: Callable[[], bytes], found: str) -> None:
    with pytest.raises(RecordingError, match=found):
        LineDevice(Answering(readline), 1000.0).play(U)


def test_a_device_slower_than_its_rate_is_refused(monkeypatch: pytest.MonkeyPatch, axis: Axis) -> None:
    monkeypatch.setattr("rig.time", simulated.Clock(tick_s=4e-3))
    with pytest.raises(RecordingError, match=r"index 0: found it 4 ms late, expected .* 1 ms; lower fs_hz"):
        LineDevice(simulated.SerialPort(axis), 1000.0).play(U)


def test_ten_lines_of_the_page_lead_from_connect_to_a_compensated_scan(
    monkeypatch: pytest.MonkeyPatch, axis: Axis, capsys: pytest.CaptureFixture[str]
) -> None:
    install(monkeypatch, "nidaqmx", Task=simulated.Nidaqmx(axis).Task)
    (block,) = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)
    lines = [line for line in block.splitlines() if line.strip() and not re.match("import|from", line)]
    assert len(lines) <= 10
    names: dict[str, Any] = {}
    exec(compile(block, "docs/rigs.md", "exec"), names)
    made, rig = names["made"], names["rig"]
    assert made.rms_um < 0.05 and f"{1e3 * made.rms_um:.0f} nm" in capsys.readouterr().out
    # Without compensation: a voltage proportional to the reference, with the same maximum.
    plain = record(rig, made.reference_um * made.u_v.max() / made.reference_um.max()).y[-len(made.y_um) :]
    assert 5 * made.rms_um < np.std(plain - made.reference_um)
    with pytest.raises(ConfigError, match="compensator: found 10000 Hz, expected the rig's 5000 Hz"):
        scan(NiDaqmx("Dev1/ao0", "Dev1/ai0", 5000.0, 1.0), names["compensator"], made.reference_um)


def test_the_page_links_every_rig() -> None:
    files = {path.name for path in (Path(__file__).parents[2] / "examples" / "rigs").glob("*.py")}
    assert files == set(re.findall(r"\(\.\./examples/rigs/(\w+\.py)\)", PAGE))
