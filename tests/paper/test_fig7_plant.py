"""The plant of Fig. 7, and its use as a stage."""

import math

import numpy as np
import pytest
import torch

from torchpi.errors import ConfigError, StageError
from torchpi.operators.conformance import OperatorLaws, wandering
from torchpi.paper.fig7_plant import FREQUENCIES_HZ, Fig7Plant, loop, loop_area


class TestOperator(OperatorLaws):
    def operator(self):
        return Fig7Plant(0.01).operator


def test_fig_7_loops_have_the_expected_areas() -> None:
    areas = [loop_area(frequency_hz) for frequency_hz in FREQUENCIES_HZ]
    assert areas == pytest.approx([10.3, 11.0, 11.9, 18.8, 27.4], rel=0.005)
    assert areas == sorted(areas)


def test_the_loop_is_closed_and_its_voltage_spans_0_to_10_v() -> None:
    u, y = loop(50)
    assert (u.min(), u.max()) == (0.0, 10.0)
    assert y[0] == pytest.approx(y[-1], abs=1e-9)


def test_the_plant_sampled_at_10_khz_has_nearly_the_same_loop_area() -> None:
    plant = Fig7Plant()
    phase = 2 * torch.pi * torch.arange(201, dtype=torch.float64)[None] / 100
    u = 5 - 5 * torch.cos(phase)  # 100 Hz at 10 kHz
    y, _ = plant.simulate(u)
    area = abs(torch.trapezoid(y[0, 100:], u[0, 100:]).item())
    assert area == pytest.approx(27.4, rel=0.005)


def test_stream_gives_the_same_bits_as_simulate() -> None:
    plant, u = Fig7Plant(), 5 + 2 * wandering(1, 2000)
    expected, reading = plant.simulate(u)
    assert torch.equal(expected, reading)
    stream = plant.stream()
    for _ in range(2):
        stream.reset(3)
        steps = np.array([stream.step(value) for value in u[0].tolist()])
        np.testing.assert_array_equal(steps[:, 0], expected[0].numpy())
        np.testing.assert_array_equal(steps[:, 1], expected[0].numpy())


def test_the_plant_responds_without_delay() -> None:
    plant, u = Fig7Plant(), torch.zeros(1, 10, dtype=torch.float64)
    u[0, 4:] = 1.0
    y, _ = plant.simulate(u)
    assert not bool(y[0, :4].any()) and bool(y[0, 4].any())


def test_invalid_voltages_and_periods_are_refused() -> None:
    with pytest.raises(StageError, match="nan V"):
        Fig7Plant().stream().step(math.nan)
    with pytest.raises(StageError, match="shape"):
        Fig7Plant().simulate(torch.zeros(5, dtype=torch.float64))
    with pytest.raises(ConfigError, match="sample_period_s"):
        Fig7Plant(0.0)
