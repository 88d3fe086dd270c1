"""Backlash: a play in series, compared with that of python-control."""

import control
import numpy as np
import pytest
import scipy.integrate
import torch
from hypothesis import given
from hypothesis import strategies as st

from tests.stage.effects.actuator.laws import PERIOD_S, EffectLaws, fixed
from torchpi.operators.conformance import wandering
from torchpi.stage.effects.effect import DataRange
from torchpi.stage.effects.mechanics.backlash import Backlash


class TestPlayLaws(EffectLaws):
    def operator(self) -> Backlash:
        return fixed(Backlash(PERIOD_S, width_um=0.3), "presliding_um")


class TestDahlLaws(EffectLaws):
    def operator(self) -> Backlash:
        return Backlash(PERIOD_S, width_um=0.3, presliding_um=0.08)


@given(width_um=st.floats(0.0, 3.0), seed=st.integers(0, 10**6))
def test_the_play_matches_the_backlash_of_python_control(width_um, seed):
    x = wandering(1, 100, seed)
    oracle = control.friction_backlash_nonlinearity(width_um)
    oracle.center = 0.0
    y = Backlash(0.1, width_um=width_um)(x)[0][0]
    assert y.tolist() == pytest.approx([oracle(sample) for sample in x[0].tolist()], abs=1e-12)


def test_at_zero_width_the_gradient_is_one_half_opposite_to_the_motion():
    effect, x = Backlash(0.1), torch.tensor([[0.5, 1.0, 2.0, 1.5, 1.0]], dtype=torch.float64)
    y = effect(x)[0][0]
    gradients = [torch.autograd.grad(y[t], effect.width_um, retain_graph=True)[0].item() for t in range(5)]
    assert gradients == [-0.5, -0.5, -0.5, 0.5, 0.5]


def test_a_search_starts_at_small_fractions_of_the_travel():
    starts = Backlash.starts(DataRange(1e4, 1.0, 0, 1, 1, 0, 20.0, {}))
    widths = [start["width_um"] for start in starts if "presliding_um" not in start]
    assert widths[0] == pytest.approx(0.02) and widths[-1] == pytest.approx(0.4)


@pytest.mark.parametrize("presliding_um", [0.05, 0.4, 3.0])
def test_with_presliding_it_solves_dahls_differential_equation(presliding_um):
    x, r = wandering(1, 60, seed=4), 0.5

    def rate(_: float, state: np.ndarray, velocity: float) -> list[float]:
        stiffness = r / presliding_um * (1 - state[0] / r * np.sign(velocity))
        return [velocity * stiffness / (1 + stiffness)]  # dd = stiffness dy, dx = dy + dd

    lost, expected, before = 0.0, [], 0.0
    for sample in x[0].tolist():
        solved = scipy.integrate.solve_ivp(
            rate, (0, 1), [lost], args=(sample - before,), rtol=1e-10, atol=1e-12
        )
        lost, before = solved.y[0, -1], sample
        expected.append(sample - lost)
    y = Backlash(0.1, width_um=2 * r, presliding_um=presliding_um)(x)[0][0].detach().numpy()
    np.testing.assert_allclose(y, expected, rtol=0, atol=1e-7)


def test_with_a_short_presliding_length_it_approaches_the_plain_play():
    x = wandering(2, 300)
    for presliding_um, away in ((1e-3, 0.02), (1e-5, 3e-4), (1e-9, 0.0)):
        sharp, soft = (Backlash(0.1, width_um=0.3, presliding_um=p)(x)[0] for p in (0.0, presliding_um))
        assert (soft - sharp).abs().max().item() <= away


@given(
    width_um=st.floats(1e-6, 1e4),
    presliding_um=st.floats(1e-12, 1e4),
    seed=st.integers(0, 10**6),
    size=st.floats(1e-6, 1e6),
)
def test_with_presliding_the_lost_motion_is_at_most_half_the_width(width_um, presliding_um, seed, size):
    x = size * wandering(1, 60, seed)
    lost = x - Backlash(0.1, width_um=width_um, presliding_um=presliding_um)(x)[0]
    assert lost.abs().max().item() <= width_um / 2 + 1e-12 * size


def test_the_form_is_play_or_dahl():
    assert Backlash.form({}) == "" == Backlash.form({"presliding_um": 1.0})
    assert Backlash.form({"width_um": 1.0}) == "play"
    assert Backlash.form({"width_um": 1.0, "presliding_um": 1.0}) == "Dahl"


@pytest.mark.parametrize(("presliding_um", "slope"), [(0.05, 1 / 7), (0.3, 0.5), (1.2, 0.8)])
def test_friction_that_hardly_stops_the_motion_at_a_reversal_is_no_lost_motion(presliding_um, slope):
    effect = Backlash(0.1, width_um=0.3, presliding_um=presliding_um)
    x = torch.cat([torch.linspace(0, 20, 2000), torch.linspace(20, 19.999, 11)]).double()[None]
    y = effect(x)[0][0]
    assert (y[-11] - y[-1]).item() / 0.001 == pytest.approx(slope, rel=0.02)
    seen = DataRange(1000.0, 2.0, 0.0, 20.0, 10.0, 0.0, 20.0, {})
    values = {"width_um": 0.3, "presliding_um": presliding_um}
    assert Backlash.reached(values, seen) is (slope <= 0.5)
