"""The loop: the timing of its signals, the measures of error, and the refusal of invalid arguments."""

import gc
import itertools
import json
import math
import subprocess
import sys
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import nn

from torchpi.control.direct_inverse import DirectInverse
from torchpi.errors import ArtifactError, ConfigError, RecordingError, StageError
from torchpi.excitation.trajectory import load_trajectory
from torchpi.export import export_files, load_torchscript
from torchpi.loop import run_loop
from torchpi.loop.result import COMPENSATED, WITHOUT, WITHOUT_LOOK_AHEAD, LoopResult, as_json
from torchpi.operators.reference_filter import ReferenceFilter
from torchpi.stage import Stage

FS_HZ = 10_000.0
GAIN_UM_PER_V = 0.8


@dataclass
class GainStage:
    """y_k = gain · u_(k - delay), without noise."""

    delay: int = 1
    sample_period_s: float = 1 / FS_HZ
    min_voltage_v: float = 0.0
    max_voltage_v: float = 10.0
    seed: int = 7
    seeds: list[int] = field(default_factory=list)

    def stream(self) -> "GainStage":
        return self

    def reset(self, seed: int) -> None:
        self.seeds.append(seed)
        self.held = [0.0] * self.delay

    def step(self, u: float) -> tuple[float, float]:
        self.held.append(GAIN_UM_PER_V * u)
        y = self.held.pop(0)
        return y, y


@dataclass
class Inverse:
    """u = factor · y_d / gain."""

    preview: int = 1
    factor: float = 1.0
    sample_period_s: float = 1 / FS_HZ
    fed: list[float] = field(default_factory=list)

    def reset(self) -> None:
        self.fed.clear()

    def step(self, yd: float) -> float:
        self.fed.append(yd)
        return self.factor * yd / GAIN_UM_PER_V


class ScriptedInverse(nn.Module):
    """The same inverse as a module to be scripted, which is what an exported file contains."""

    def __init__(self) -> None:
        super().__init__()
        self.sample_period_s = 1 / FS_HZ
        self.preview = 1
        self.last = 0.0

    @torch.jit.export
    def reset(self) -> None:
        self.last = 0.0

    @torch.jit.export
    def step(self, yd: float) -> float:
        self.last = yd
        return yd / 0.8


def sine(frequency_hz: float = 20.0, samples: int = 2_000) -> np.ndarray:
    return 3.0 - 3.0 * np.cos(2 * np.pi * frequency_hz * np.arange(samples) / FS_HZ)


def run(compensator, stage=None, yd=None, **options) -> LoopResult:
    yd = sine() if yd is None else yd
    return run_loop(compensator, stage or GainStage(), yd, **{"fs_hz": FS_HZ, "name": "sine", **options})


# --- timing of the signals, and measures of error


def test_a_perfect_compensator_has_no_error():
    result = run(Inverse(preview=1))
    tracking = result.compensated.on_true
    for error in (tracking.loading, tracking.steady, tracking.whole):
        assert error.max_um < 1e-14
    assert result.compensated.on_sensor == tracking
    assert result.compensated.loop_width_um < 1e-14


def test_a_scripted_module_gives_the_same_voltages():
    scripted = torch.jit.script(ScriptedInverse())
    np.testing.assert_array_equal(run(scripted).compensated.u, run(Inverse()).compensated.u)


@settings(max_examples=10)
@given(st.integers(0, 3), st.integers(1, 3))
def test_an_uncompensated_delay_gives_its_analytic_error(preview: int, delay: int):
    """The error of a sine delayed by d samples is at most A · 2 sin(π f d T), and its rms that over √2."""
    late = delay - preview
    f_hz, amplitude = 20.0, 3.0
    result = run(Inverse(preview=preview), GainStage(delay=delay), sine(f_hz, 4_000))
    steady = result.compensated.on_true.steady
    most = 2 * amplitude * abs(math.sin(math.pi * f_hz * late / FS_HZ))
    assert steady.max_um == pytest.approx(most, rel=1e-3, abs=1e-9)
    if late >= 0:  # a look-ahead that is too long reaches the held end
        assert steady.rms_um == pytest.approx(most / math.sqrt(2), rel=0.02, abs=1e-9)


def test_the_compensator_is_fed_future_samples_and_finally_the_last_value():
    compensator, yd = Inverse(preview=3), sine()
    run(compensator, yd=yd)
    assert compensator.fed == [*yd[3:], *[yd[-1]] * 3]


def test_a_compensator_with_the_filter_inside_is_fed_the_reference():
    compensator, yd = Inverse(preview=0), sine()
    compensator.has_reference_filter = True
    other = Inverse(preview=0)
    result = run(compensator, yd=yd, yr=yd + 1.0, compare={"other": other})
    assert compensator.fed == list(yd + 1.0)
    assert other.fed == list(yd)
    np.testing.assert_array_equal(result.yd, yd)


def test_the_uncompensated_drive_is_the_straight_line_through_the_slow_loop():
    result = run(Inverse())
    assert result.gain_um_per_v == pytest.approx(GAIN_UM_PER_V, rel=1e-4)
    np.testing.assert_allclose(result.without.u, sine() / GAIN_UM_PER_V, rtol=1e-4)
    assert (result.range_low_um, result.range_high_um) == (0.0, pytest.approx(8.0))


def test_the_straight_line_is_also_run_with_the_look_ahead_of_the_compensator():
    result = run(Inverse(preview=1))
    assert list(result.drives) == [WITHOUT, WITHOUT_LOOK_AHEAD, COMPENSATED]
    assert result.drives[WITHOUT_LOOK_AHEAD].on_true.whole.max_um < 1e-3
    assert list(run(Inverse(preview=0)).drives) == [WITHOUT, COMPENSATED]


def test_compared_compensators_run_as_further_drives():
    result = run(Inverse(), compare={"least_squares": Inverse(factor=1.01)})
    drive = result.drives["least_squares"]
    assert drive.label == "least squares"
    assert drive.on_true.whole.max_um == pytest.approx(0.06, rel=1e-6)
    assert drive.on_true.whole.max_percent == pytest.approx(1.0, rel=1e-6)
    assert drive.on_true.whole.max_percent_of_range == pytest.approx(0.75, rel=1e-3)


def test_improvement_is_the_ratio_of_the_errors():
    result = run(Inverse(preview=0, factor=1.001))
    for part in ("loading", "steady", "whole"):
        for size in ("max", "rms"):
            before = getattr(getattr(result.without.on_true, part), f"{size}_um")
            after = getattr(getattr(result.compensated.on_true, part), f"{size}_um")
            assert getattr(result.improvement[COMPENSATED], f"{part}_{size}") == before / after


def test_loading_ends_where_the_trajectory_first_reaches_its_maximum():
    yd = sine(20.0)
    yd[600:] *= 0.9995  # the first maximum, at sample 250, is the global one
    result = run(Inverse(), yd=yd)
    top = yd.max() - 1e-3 * np.ptp(yd)
    assert (yd[: result.loading_samples] < top).all()
    assert yd[result.loading_samples] >= top
    assert result.loading_samples < 250


def test_an_error_during_loading_does_not_count_in_the_steady_part():
    class Stumbling(Inverse):
        def step(self, yd: float) -> float:
            u = super().step(yd)
            return u + 1.0 if len(self.fed) == 50 else u

    tracking = run(Stumbling()).compensated.on_true
    assert tracking.loading.max_um == pytest.approx(GAIN_UM_PER_V)
    assert tracking.whole.max_um == tracking.loading.max_um
    assert tracking.steady.max_um < 1e-14


def test_the_whole_combines_the_loading_and_the_steady_part():
    result = run(Inverse(preview=0))
    tracking, n, size = result.compensated.on_true, result.loading_samples, len(result.yd)
    squares = n * tracking.loading.rms_um**2 + (size - n) * tracking.steady.rms_um**2
    assert tracking.whole.rms_um == pytest.approx(math.sqrt(squares / size))
    assert tracking.whole.max_um == max(tracking.loading.max_um, tracking.steady.max_um)


def test_the_loop_width_is_the_spread_at_one_displacement():
    """A pure delay of phase φ turns a sine of amplitude A into an ellipse 2 A sin φ wide."""
    result = run(Inverse(preview=0), GainStage(delay=5), sine(20.0, 10_000))
    width = 2 * 3.0 * math.sin(2 * math.pi * 20.0 * 5 / FS_HZ)
    assert result.compensated.loop_width_um == pytest.approx(width, rel=0.02)
    assert result.compensated.loop_width_percent == pytest.approx(100 * width / 6.0, rel=0.02)


def test_saturation_counts_the_samples_at_a_limit():
    class Clipped(Inverse):
        def step(self, yd: float) -> float:
            return min(super().step(yd), 5.0)

    compensator = Clipped(preview=0)
    compensator.max_voltage_v = 5.0
    yd = sine()
    at_a_limit = (yd / GAIN_UM_PER_V >= 5.0) | (yd <= 0.0)
    assert run(compensator, yd=yd).compensated.saturated_share == pytest.approx(at_a_limit.mean())


def test_every_drive_is_run_with_the_same_noise():
    stage = GainStage()
    assert run(Inverse(), stage, seed=3).seed == 3
    assert set(stage.seeds) == {3}
    assert run(Inverse(), stage).seed == stage.seed


def test_a_jump_at_the_start_and_a_short_steady_part_are_noted():
    assert run(Inverse()).notes == ()
    assert "starts at 1 µm" in run(Inverse(), yd=sine() + 1.0).notes[0]
    assert "steady part is short" in run(Inverse(), yd=np.linspace(0.0, 5.0, 500)).notes[0]


# --- time


def clock_of(step_ns: list[int]):
    """Return a clock whose two readings around each step differ by these durations in turn."""
    durations = itertools.cycle(step_ns)
    now, inside = 0, False

    def clock() -> int:
        nonlocal now, inside
        now += next(durations) if inside else 1_000_000
        inside = not inside
        return now

    return clock


def test_missed_deadlines_are_steps_longer_than_the_period():
    yd = sine(20.0, 1_000)
    # One in ten takes 100.001 µs of 100 µs; exactly 100 µs is in time.
    latency = run(Inverse(), yd=yd, clock=clock_of([5_000] * 8 + [100_000, 100_001])).compensated.latency
    assert (latency.steps, latency.missed, latency.missed_share) == (1_000, 100, 0.1)
    assert latency.period_us == pytest.approx(100.0)


def test_latency_percentiles_are_those_of_the_steps():
    # Each drive has a thousand steps, so the compensator's, which come last, see the cycle from its start.
    yd = sine(20.0, 1_000)
    latency = run(
        Inverse(), yd=yd, clock=clock_of([*[6_000] * 985, *[40_000] * 14, 250_000])
    ).compensated.latency
    assert latency.median_us == 6.0
    assert latency.p99_us == 40.0
    assert 40.0 < latency.p999_us < latency.max_us == 250.0


@settings(max_examples=8)
@given(st.lists(st.integers(0, 10**9), min_size=1, max_size=20))
def test_the_histogram_counts_every_step(step_ns: list[int]):
    latency = run(Inverse(), yd=sine(20.0, 500), clock=clock_of(step_ns)).compensated.latency
    assert latency.histogram_counts.sum() == latency.steps == 500
    assert (np.diff(latency.histogram_edges_us) > 0).all()


def test_no_garbage_is_collected_inside_a_step():
    class Watching(Inverse):
        def step(self, yd: float) -> float:
            assert not gc.isenabled()
            return super().step(yd)

    run(Watching())
    assert gc.isenabled()


# --- refused arguments


def test_a_compensator_with_another_sample_rate_is_refused():
    with pytest.raises(ArtifactError, match=r"torchpi: .*0\.0002 s, but the stage's is 0\.0001 s"):
        run(Inverse(sample_period_s=2e-4))
    with pytest.raises(ArtifactError, match=r"old: .*0\.0002 s"):
        run(Inverse(), compare={"old": Inverse(sample_period_s=2e-4)})
    with pytest.raises(ArtifactError, match=r"sine: .*0\.0002 s"):
        run(Inverse(), fs_hz=5_000.0)


def test_a_voltage_that_is_not_finite_is_refused_with_its_sample():
    class Failing(Inverse):
        def step(self, yd: float) -> float:
            return super().step(yd) if len(self.fed) < 40 else math.nan

    with pytest.raises(ArtifactError, match=r"nan V at sample 40"):
        run(Failing())
    assert gc.isenabled()


@pytest.mark.parametrize(
    ("key", "value"),
    [("max_slew_v_s", -5.0), ("max_slew_v_s", "5"), ("max_slew_v_s", math.nan), ("fs_hz", 0)],
)
def test_a_rate_that_is_not_a_positive_number_is_named_in_the_error(key: str, value: object):
    with pytest.raises(ConfigError, match=rf"{key}: found .*, expected a positive number of"):
        run(Inverse(), **{key: value})


def test_objects_that_are_not_a_compensator_or_a_stage_are_refused():
    with pytest.raises(ArtifactError, match="compensator: found DirectInverse without 'reset', expected one"):
        run(DirectInverse(1 / FS_HZ, [0.0]))
    with pytest.raises(ArtifactError, match="stage: found str without 'sample_period_s', expected a stage"):
        run(Inverse(), "default")


def test_a_trajectory_outside_the_range_is_refused_and_the_range_stated():
    with pytest.raises(
        RecordingError, match=r"sample 250 is 9 µm, outside the range of this stage, 0 to 8 µm"
    ):
        run(Inverse(), yd=1.5 * sine())


@pytest.mark.parametrize(
    ("yd", "found"),
    [
        (np.full(100, 2.0), "stays at 2 µm"),
        (np.array([0.0] * 50 + [math.nan] * 50), "sample 50 is nan"),
        (np.zeros(3), "shape"),
    ],
)
def test_a_trajectory_that_cannot_be_followed_is_refused(yd: np.ndarray, found: str):
    with pytest.raises(RecordingError, match=found):
        run(Inverse(), yd=yd)


def test_a_stage_without_finite_voltage_limits_is_refused():
    with pytest.raises(StageError, match=r"voltage limits of 0\.0 and inf V"):
        run(Inverse(), GainStage(max_voltage_v=math.inf))


def test_a_compared_compensator_cannot_take_the_name_of_another_drive():
    with pytest.raises(ArtifactError, match="'without'"):
        run(Inverse(), compare={WITHOUT: Inverse()})


# --- real compensators and the simulated stage


def test_an_exported_compensator_runs_against_the_simulated_stage(tmp_path: Path):
    limits = {"min_voltage_v": 0.0, "max_voltage_v": 10.0}
    stage = Stage.from_dict({"sample_rate_hz": FS_HZ, "amplifier": limits, "seed": 1})
    compensator = DirectInverse(1 / FS_HZ, [0.0, 0.5], preview=1)  # the stage: 1 µm/V, late by a sample
    with torch.no_grad():
        compensator.weights.theta[0, 0] = 1.0
    export_files(compensator, tmp_path / "plain", ["torchscript"])
    export_files(compensator, tmp_path / "filter", ["torchscript"], ReferenceFilter(1 / FS_HZ))
    fast = load_trajectory("fast", fs_hz=FS_HZ)
    result = run_loop(
        load_torchscript(tmp_path / "plain.pt"),
        stage,
        fast.yd,
        fs_hz=FS_HZ,
        name=fast.name,
        yr=fast.yr,
        compare={"filter_inside": load_torchscript(tmp_path / "filter.pt")},
    )
    assert result.gain_um_per_v == pytest.approx(1.0, rel=1e-3)
    # With a look-ahead, the filter inside starts from y_r at that sample; the difference decays.
    assert result.compensated.on_true.whole.max_um < 1e-12
    assert result.drives["filter_inside"].on_true.steady.max_um < 1e-9
    y_true, y_sensor = stage.simulate(torch.from_numpy(result.compensated.u)[None])
    np.testing.assert_array_equal(result.compensated.y_true, y_true[0].detach().numpy())
    np.testing.assert_array_equal(result.compensated.y_sensor, y_sensor[0].detach().numpy())


def test_the_json_holds_plain_values_and_names_their_units():
    result = run(Inverse(), compare={"other": Inverse(factor=1.1)})
    content = json.loads(json.dumps(as_json(result), allow_nan=False))
    assert content["drives"]["other"]["true_displacement"]["steady"]["rms_um"] == pytest.approx(
        result.drives["other"].on_true.steady.rms_um
    )
    assert sum(content["drives"][COMPENSATED]["latency"]["histogram_counts"]) == content["samples"]


def test_importing_the_loop_does_not_import_matplotlib():
    code = "import sys, torchpi.loop; sys.exit('matplotlib' in sys.modules or 'lightning' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
