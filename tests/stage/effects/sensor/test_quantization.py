"""Quantisation: readings on a lattice, and the lattice step estimated from recorded readings."""

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from tests.stage.effects.actuator.laws import PERIOD_S, EffectLaws
from torchpi.operators.conformance import wandering
from torchpi.stage.effects.effect import DataRange
from torchpi.stage.effects.sensor.quantization import Quantization, half_width_um, uneven_codes


class TestLaws(EffectLaws):
    differentiable = False

    def operator(self) -> Quantization:
        return Quantization(PERIOD_S, lsb_um=0.03, offset_um=0.011)

    def test_the_tangent_matches_finite_differences_of_the_output(self):
        x, dx = wandering(1, 200), wandering(3, 200, seed=1)
        assert torch.equal(self.operator().tangent(x, dx), dx)  # straight-through

    def test_gradient_passes_straight_through(self):
        effect, x = self.operator(), wandering(1, 50).requires_grad_()
        weights = torch.randn(1, 50, dtype=torch.float64)
        (weights * effect(x)[0]).sum().backward()
        assert torch.equal(x.grad, weights)
        assert effect.lsb_um.grad.item() == effect.offset_um.grad.item() == 0


@given(lsb_um=st.floats(1e-4, 1.0), offset_um=st.floats(-1.0, 1.0))
def test_every_reading_is_the_nearest_lattice_point(lsb_um, offset_um):
    x = 3 * wandering(1, 500)
    y = Quantization(1e-4, lsb_um=lsb_um, offset_um=offset_um)(x)[0]
    codes = (y - offset_um) / lsb_um
    torch.testing.assert_close(codes, codes.round(), rtol=0, atol=1e-9)
    assert (y - x).abs().max().item() <= lsb_um / 2 * (1 + 1e-9)


def test_a_search_has_no_starts_because_the_lattice_is_read_off_the_readings():
    assert Quantization.starts(DataRange(1e4, 1.0, 0, 1, 1, 0, 1, {})) == []


def readings(seed: int, noise_um: float, time: int = 4000) -> np.ndarray:
    """Return a sine of 20 µm with noise, (time,)."""
    sine = 20 * np.sin(np.linspace(0, 17, time))
    return 12 + sine + noise_um * np.random.default_rng(seed).standard_normal(time)


def on_lattice(y: np.ndarray, lsb_um: float, offset_um: float) -> np.ndarray:
    effect = Quantization(1e-4, lsb_um=lsb_um, offset_um=offset_um)
    return effect(torch.from_numpy(y)[None])[0][0].detach().numpy()


lattices = given(
    seed=st.integers(0, 1000),
    lsb_um=st.floats(5e-4, 0.5).filter(lambda step: abs(np.log10(step) % 1) > 1e-3),
    offset_um=st.floats(-1.0, 1.0),
    noise_um=st.sampled_from([0.0, 1e-3, 0.03]),
)


@lattices
def test_a_step_finer_or_coarser_than_the_noise_is_found_in_recorded_readings(
    seed, lsb_um, offset_um, noise_um
):
    y = on_lattice(readings(seed, noise_um), lsb_um, offset_um)
    assert Quantization.lattice(y) == pytest.approx(lsb_um, rel=1e-9)


@lattices
def test_the_step_is_found_despite_the_rounding_of_a_file(seed, lsb_um, offset_um, noise_um):
    y = on_lattice(readings(seed, noise_um), lsb_um, offset_um)
    for rounded in (y.astype(np.float32), np.round(y, 5)):
        assert Quantization.lattice(rounded) == pytest.approx(lsb_um, rel=1e-5)


def test_the_step_of_16_bits_over_the_whole_range_is_found():
    lsb_um = 40.5 / 2**16
    for time in (1000, 100_000):
        for y in (
            on_lattice(readings(0, 0.004, time), lsb_um, 0.1),
            on_lattice(readings(0, 0.0, time), lsb_um, 0),
        ):
            assert Quantization.lattice(y) == pytest.approx(lsb_um, rel=1e-6)
            assert Quantization.lattice(y.astype(np.float32)) == pytest.approx(lsb_um, rel=1e-6)


@given(seed=st.integers(0, 1000), noise_um=st.sampled_from([0.0, 1e-4, 0.03]))
def test_readings_without_steps_lie_on_no_lattice(seed, noise_um):
    y = readings(seed, noise_um)
    for kept in (y, y.astype(np.float32), np.round(y, 6), np.round(y, 5)):
        assert Quantization.lattice(kept) is None


@given(st.lists(st.floats(-1e6, 1e6), max_size=40))
def test_arbitrary_readings_give_a_positive_step_or_none(values):
    step = Quantization.lattice(np.array(values))
    assert step is None or step > 0


def test_too_few_distinct_readings_give_no_step():
    assert Quantization.lattice(np.array([0.0, 0.1, 0.3, 0.1, 0.0])) is None
    assert Quantization.lattice(np.zeros(100)) is None


@given(seed=st.integers(0, 1000), codes=st.integers(4, 7))
def test_a_step_so_coarse_that_few_readings_differ_is_found_where_they_recur_at_other_commands(seed, codes):
    u = np.sin(np.linspace(0, 60, 6000)) + 1e-2 * np.random.default_rng(seed).standard_normal(6000)
    x = np.clip(u, -1, 1) * (codes - 1) / 2
    y = on_lattice(x, 1.0, 0.5 * (codes - 1) % 1.0)
    assert len(np.unique(y)) == codes
    assert Quantization.lattice(y) is None
    assert Quantization.lattice(y, u) == pytest.approx(1.0)


def test_a_stage_without_noise_that_is_sent_to_few_places_again_shows_no_step():
    u = np.repeat(np.tile([0.0, 1.0, 2.0, 3.0, 4.0, 3.0, 2.0, 1.0], 5), 50)
    assert Quantization.lattice(2.0 * u, u) is None


@given(seed=st.integers(0, 1000), codes=st.integers(10, 60))
def test_the_typical_step_of_a_converter_with_uneven_codes_is_found(seed, codes):
    rng = np.random.default_rng(seed)
    places = np.cumsum(rng.uniform(0.7, 1.3, codes))
    u = np.sin(np.linspace(0, 60, 6000)) + 1e-3 * rng.standard_normal(6000)
    x = (u + 1.1) / 2.2 * (places[-1] - places[0]) + places[0]
    y = places[np.abs(x[:, None] - places).argmin(1)]
    assert uneven_codes(y, u).step_um == pytest.approx(1.0, rel=0.25)
    assert uneven_codes(x, u) is None


@pytest.mark.parametrize("samples", [1000, 2500, 6000])
def test_the_typical_step_is_found_although_most_readings_are_on_different_codes(samples):
    places = np.cumsum(np.random.default_rng(0).uniform(0.4, 1.6, 500))
    u = np.sin(np.linspace(0, 60, samples)) + 1e-3 * np.random.default_rng(1).standard_normal(samples)
    x = (u + 1.1) / 2.2 * (places[-1] - places[0]) + places[0]
    y = places[np.abs(x[:, None] - places).argmin(1)]
    assert uneven_codes(y, u).step_um == pytest.approx(1.0, rel=0.25)
    assert uneven_codes(x, u) is None


def test_the_interval_of_a_rounded_lattice_covers_its_step_in_nine_of_ten_files():
    covered, files, widths = 0, 100, []
    for seed in range(files):
        rng = np.random.default_rng(seed)
        lsb_um = rng.uniform(0.009, 0.02)
        y = np.round(on_lattice(rng.uniform(0, 1.5, 400), lsb_um, rng.uniform(0, lsb_um)), 3)
        step_um = Quantization.lattice(y)
        half_um = half_width_um(y, step_um)
        covered += abs(step_um - lsb_um) < half_um
        widths.append(half_um / lsb_um)
    assert 0.8 * files < covered < 0.98 * files
    assert max(widths) < 1e-3


@pytest.mark.parametrize("samples", [800, 6000])
def test_the_interval_of_an_uneven_step_covers_it_in_nine_of_ten_converters(samples):
    """The design's step is the mean width of all codes; only some were passed, and few readings miss more."""
    covered, seeds = 0, 100
    for seed in range(seeds):
        rng = np.random.default_rng(seed)
        places = np.cumsum(rng.uniform(0.7, 1.3, 60))
        u = np.sin(np.linspace(0, 60, samples)) + 1e-3 * rng.standard_normal(samples)
        x = (u + 1.1) / 2.2 * (places[-1] - places[0]) + places[0]
        found = uneven_codes(places[np.abs(x[:, None] - places).argmin(1)], u)
        covered += abs(found.step_um - 1.0) < found.half_width_um
    assert 0.8 * seeds < covered < 0.97 * seeds


def test_a_step_has_an_interval_even_if_no_two_neighbouring_codes_were_read():
    rng = np.random.default_rng(0)
    places = np.cumsum(rng.uniform(0.7, 1.3, 40))
    y = rng.permutation(np.concatenate([places, places[::2], places[::2]]))
    found = uneven_codes(y, rng.standard_normal(len(y)))
    assert found.step_um < 0.5 * np.diff(places).min()
    assert 0 < found.half_width_um < np.inf


def test_a_command_of_few_values_or_a_file_of_few_decimals_is_not_a_converter():
    levels = np.random.default_rng(0).uniform(0.8, 1.2, 20).cumsum()
    at = np.repeat(np.arange(20), 100)
    assert uneven_codes(levels[at], 7.0 * at) is None
    u = np.sin(np.linspace(0, 60, 6000))
    assert uneven_codes(np.round(u, 1), u) is None
    for decimals in (2, 3):
        assert (
            uneven_codes(np.round(u + 1e-3 * np.random.default_rng(0).standard_normal(6000), decimals), u)
            is None
        )


def test_readings_that_a_stage_without_noise_repeats_are_not_a_converter():
    """It repeats them with its command, and holds them at a rail; a slow sensor holds each for a while."""
    u = np.tile(np.sin(np.linspace(0, 60, 1000)), 6)
    assert uneven_codes(u + 0.1 * u**3, u * (1 + 1e-9 * np.arange(6000))) is None
    assert uneven_codes(np.clip(u + 1e-3 * np.arange(6000), None, 2.0), u + 1e-4 * np.arange(6000)) is None
    u = np.random.default_rng(0).standard_normal(6000).cumsum()
    assert uneven_codes(np.repeat(u[::3], 3), u) is None
