"""The hysteresis as an operator: equality with the model of the search, bits of the stream, gradients."""

import numpy as np
import pytest
import scipy.integrate
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from torchpi.diagnosis.hysteresis_model import HysteresisModel
from torchpi.errors import StageError
from torchpi.operators.conformance import HysteresisLaws, OperatorLaws, wandering
from torchpi.operators.hysteresis_rows import DUHEM_POWERS, bouc_wen
from torchpi.stage.hysteresis import IDENTITY, Hysteresis

PERIOD_S = 0.1
THRESHOLDS_V = [0.0, 0.11, 0.43, 0.9]
RANGE_V = (-1.1, 0.9)
INSIDE_IT = {
    "asymmetry_per_v": 0.03,
    "incongruence_per_v": 0.05,
    "straight_share": 0.4,
    "weight_s_per_v": 0.02,
    "threshold_s_per_v": 0.04,
    "loop_per_e": 0.05,
    "chord_share": 0.8,
    "reference_rate_v_s": 0.7,
    "rate_filter_s": 0.15,
}
FAMILIES = {"sigma_v": 0.31, "beta": 0.6, "exponent": 1.7, "alpha_per_v": 0.5}


def hysteresis(pieces: int = 1, bouc_wen: bool = False, duhem: bool = False, **shape: float) -> Hysteresis:
    count = len(THRESHOLDS_V) * pieces + bouc_wen + len(DUHEM_POWERS) * duhem + 1
    weights = torch.linspace(0.9, 0.1, count, dtype=torch.float64)
    needed = {"sigma_v": bouc_wen, "beta": bouc_wen, "exponent": bouc_wen, "alpha_per_v": duhem}
    own = {name: FAMILIES[name] for name, there in needed.items() if there}
    shape = {**own, **shape}
    made = Hysteresis(PERIOD_S, THRESHOLDS_V, weights, pieces, RANGE_V, 2.0, bouc_wen, duhem, shape)
    # At 0 the asymmetry has a kink: to one side of it the play with r = 0 has memory.
    made.asymmetry_per_v.requires_grad_("asymmetry_per_v" in shape)
    return made


class TestPlays(HysteresisLaws):
    def operator(self) -> Hysteresis:
        return hysteresis()


class TestPlaysThroughOutputFunctions(OperatorLaws):
    def operator(self) -> Hysteresis:
        return hysteresis(pieces=3)


class TestEffectsInside(OperatorLaws):
    def operator(self) -> Hysteresis:
        return hysteresis(pieces=2, **INSIDE_IT)


class TestRelaxingPlays(OperatorLaws):
    def operator(self) -> Hysteresis:
        return hysteresis(pieces=2, **INSIDE_IT, relaxation_s=0.07)


class TestBoucWen(OperatorLaws):
    def operator(self) -> Hysteresis:
        return hysteresis(bouc_wen=True)


class TestDuhem(OperatorLaws):
    def operator(self) -> Hysteresis:
        return hysteresis(duhem=True)


@given(
    pieces=st.integers(1, 4),
    bouc_wen=st.booleans(),
    duhem=st.booleans(),
    inside=st.booleans(),
    relaxation_s=st.sampled_from([0.0, 0.07]),
    seed=st.integers(0, 99),
)
@settings(max_examples=40, deadline=None)
def test_it_equals_the_hysteresis_model_that_the_search_fitted(
    pieces: int, bouc_wen: bool, duhem: bool, inside: bool, relaxation_s: float, seed: int
) -> None:
    shape = {**(INSIDE_IT if inside else {}), "relaxation_s": relaxation_s}
    operator = hysteresis(pieces, bouc_wen, duhem, **shape)
    nominal = HysteresisModel(
        np.array(THRESHOLDS_V), pieces, RANGE_V, 2.0, bouc_wen, duhem, {**IDENTITY, **operator.shape()}
    )
    v = wandering(1, 300, seed)
    weights = operator.weights.detach().numpy().copy()
    wanted = nominal.output(v[0].numpy(), PERIOD_S, weights[:-1]) + weights[-1]
    with torch.no_grad():
        operator.weights[:-1] = torch.from_numpy(nominal.of_stage(weights[:-1]))
        np.testing.assert_allclose(operator(v)[0][0].numpy(), wanted, rtol=0, atol=1e-12)


def test_by_default_its_shape_has_every_effect_at_its_identity() -> None:
    assert HysteresisModel(np.zeros(1)).shape == IDENTITY == Hysteresis(PERIOD_S, [0.0], [1.0, 0.0]).shape()


def test_gradients_are_exact_over_a_record_of_many_tiles() -> None:
    operator, v = hysteresis(pieces=2, **INSIDE_IT), wandering(2, 1000).requires_grad_()
    direction = wandering(2, 1000, seed=5)
    (gradient,) = torch.autograd.grad(operator(v)[0].square().sum(), v)
    with torch.no_grad():
        ends = [operator(v + step * direction)[0].square().sum() for step in (1e-7, -1e-7)]
    wanted = (ends[0] - ends[1]) / 2e-7
    torch.testing.assert_close((gradient * direction).sum(), wanted, rtol=1e-5, atol=0)


def test_one_thread_or_several_give_the_same_bits() -> None:
    operator, v = hysteresis(pieces=2, **INSIDE_IT), wandering(4, 700)
    before, found = torch.get_num_threads(), []
    for threads in (1, 3):
        torch.set_num_threads(threads)
        operator.zero_grad()
        y, _ = operator(v)
        y.square().sum().backward()
        assert operator.weights.grad is not None
        found.append((y.detach(), operator.weights.grad.clone()))
    torch.set_num_threads(before)
    assert torch.equal(found[0][0], found[1][0]) and torch.equal(found[0][1], found[1][1])


def test_rate_dependence_is_the_same_at_two_sample_rates() -> None:
    shape = {**INSIDE_IT, "rate_filter_s": 0.5}
    weights = torch.linspace(0.9, 0.1, 5, dtype=torch.float64)
    outputs = []
    for per_second in (200, 2000):
        t = torch.arange(20 * per_second, dtype=torch.float64)[None] / per_second
        operator = Hysteresis(1 / per_second, THRESHOLDS_V, weights, shape=shape)
        with torch.no_grad():
            outputs.append(operator(torch.sin(t) ** 2)[0][:, :: per_second // 200])
    torch.testing.assert_close(*outputs, rtol=0, atol=1e-3)


def test_a_bouc_wen_state_follows_its_differential_equation() -> None:
    from scipy.integrate import solve_ivp

    sigma, beta, n = 0.31, 0.6, 1.7

    def slope(_: float, z: np.ndarray) -> np.ndarray:
        return (1 - np.abs(z) ** n * (1 - beta + beta * np.sign(z))) / sigma

    wanted = solve_ivp(slope, (0, 1), [0.0], rtol=1e-10, atol=1e-12).y[0, -1]
    assert bouc_wen(0.0, 1.0, sigma, beta, n) == pytest.approx(wanted, abs=1e-4)


@given(
    st.floats(-1.2, 1.2),
    st.floats(-300.0, 300.0),
    st.floats(1e-2, 1e2),
    st.floats(0.0, 3.0),
    st.floats(0.5, 6.0),
)
def test_a_bouc_wen_state_that_ends_early_has_the_bits_of_all_its_steps(
    z: float, dv: float, sigma: float, beta: float, n: float
) -> None:
    pieces = int(abs(dv) / sigma * 20) + 1
    step, last = dv / pieces, z
    for _ in range(min(pieces, 3000)):  # by then it is ±1, see below
        at = last
        for part in (0.5, 1.0):
            outward = 1 - beta + beta * (1.0 if at * step >= 0 else -1.0)
            at = last + part * step / sigma * (1 - abs(at) ** n * outward)
        last = at
    assert bouc_wen(z, dv, sigma, beta, n) == last


def test_a_move_of_any_length_saturates_a_bouc_wen_state_in_a_limited_number_of_steps() -> None:
    assert bouc_wen(0.3, 1e12, 1.0, 0.6, 1.2) == pytest.approx(1, abs=1e-14)  # 2e13 steps would take days
    assert bouc_wen(0.3, -1e12, 1.0, 0.6, 1.2) == pytest.approx(-1, abs=1e-14)


def test_it_can_be_rebuilt_from_its_settings() -> None:
    operator, v = hysteresis(2, True, True, **INSIDE_IT), wandering(1, 100)
    again = Hysteresis(PERIOD_S, **operator.settings())
    assert torch.equal(again(v)[0], operator(v)[0])


def test_inconsistent_arguments_are_refused() -> None:
    with pytest.raises(StageError, match="weights: found 2, expected 3"):
        Hysteresis(PERIOD_S, [0.0, 1.0], [1.0, 0.0])
    with pytest.raises(StageError, match="pieces: found 0 between -1 and 1 V"):
        Hysteresis(PERIOD_S, [0.0], [0.0], 0)
    with pytest.raises(StageError, match="sigma_v: found none"):
        Hysteresis(PERIOD_S, [0.0], [1.0, 0.5, 0.0], bouc_wen=True)
    with pytest.raises(StageError, match="alpha_per_v: found 1"):
        Hysteresis(PERIOD_S, [0.0], [1.0, 0.0], shape={"alpha_per_v": 1.0})


def test_a_relaxing_play_solves_its_differential_equation_for_a_held_voltage() -> None:
    v, tau, r = wandering(1, 80)[0].numpy(), 0.3, 0.4
    operator = Hysteresis(PERIOD_S, [r], [1.0, 0.0], shape={"relaxation_s": tau})
    h, expected = 0.0, []
    for sample in v:
        solved = scipy.integrate.solve_ivp(
            lambda _, h, sample=sample: np.maximum(sample - h - r, np.minimum(sample - h + r, 0.0)) / tau,
            (0.0, PERIOD_S),
            [h],
            rtol=1e-11,
            atol=1e-13,
        )
        h = solved.y[0, -1]
        expected.append(h)
    y = operator(torch.from_numpy(v)[None])[0][0].detach().numpy()
    np.testing.assert_allclose(y, expected, rtol=0, atol=1e-9)


def test_plays_that_relax_almost_instantly_equal_plain_plays() -> None:
    x = wandering(2, 300)
    plain, late = (hysteresis(pieces=3, **INSIDE_IT, **more)(x)[0] for more in ({}, {"relaxation_s": 1e-4}))
    torch.testing.assert_close(late, plain, rtol=0, atol=1e-13)


def test_relaxing_plays_are_the_same_at_two_sample_rates() -> None:
    held = wandering(1, 200)
    slow = hysteresis(relaxation_s=0.25)
    fast = Hysteresis(PERIOD_S / 10, THRESHOLDS_V, slow.weights.detach(), 1, RANGE_V, 2.0, shape=slow.shape())
    fine = fast(held.repeat_interleave(10, 1))[0][:, 9::10]
    torch.testing.assert_close(fine, slow(held)[0], rtol=0, atol=1e-12)
