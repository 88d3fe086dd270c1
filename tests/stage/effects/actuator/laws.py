"""Laws that every effect between the voltage and the reading obeys, as tests to inherit."""

import math

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from torch import Tensor

from torchpi.errors import StageError
from torchpi.operators.conformance import OperatorLaws, wandering
from torchpi.stage.effects.effect import DataRange, Effect

PERIOD_S = 0.1

spans = st.floats(1e-3, 1e3)
recordings = st.builds(
    DataRange,
    fs_hz=st.floats(10.0, 1e6),
    duration_s=st.floats(1e-3, 1e5),
    low_v=st.just(0.0),
    high_v=st.just(0.0) | spans,
    max_rate_v_s=st.floats(0.0, 1e7),
    low_um=st.just(0.0),
    high_um=st.just(0.0) | spans,
    aux=st.just({}),
)


class EffectLaws(OperatorLaws):
    """Laws of an effect; a test class that inherits them defines how to build the effect, at `PERIOD_S`."""

    def operator(self) -> Effect:
        """Build the effect under test, with every parameter away from its identity value."""
        raise TypeError(f"{type(self).__name__} must define operator()")

    def test_every_parameter_has_a_quantity_and_an_identity_value(self):
        effect = self.operator()
        assert set(effect.quantities) == set(effect.identity) == set(dict(effect.named_parameters()))
        assert set(effect.per_recording) <= set(effect.quantities)
        # An effect of several forms may be tested in one of them, with the others at their identity.
        away = {n: v != effect.identity[n] for n, v in effect.values().items() if n not in effect.kinds}
        assert any(away.values()) if effect.forms else all(away.values())

    def test_its_form_is_a_declared_one_and_empty_at_the_identity(self):
        effect = self.operator()
        assert effect.form(effect.identity) == effect.form({}) == ""
        found = effect.form(effect.values())
        assert set(found.split(" + ")) <= {*effect.forms, ""}
        assert bool(found) == bool(effect.forms)

    @pytest.mark.parametrize("fs_hz", [10.0, 8000.0, 50_000.0])
    def test_with_default_values_it_is_the_identity_to_the_last_bit(self, fs_hz):
        x, dx = wandering(2, 300), wandering(3, 300, seed=1)
        effect = type(self.operator())(1 / fs_hz)
        assert effect.values() == effect.identity
        assert torch.equal(effect(x)[0], x)
        assert torch.equal(effect.tangent(x[:1], dx), dx)

    def test_a_value_out_of_bounds_is_refused_with_its_name_and_unit(self):
        effect = type(self.operator())
        for name, quantity in (effect.quantities | effect.accepted).items():
            bad = {quantity.at_least - 1, quantity.at_most * 1.01, math.nan} - {effect.identity[name]}
            for value in bad:
                with pytest.raises(StageError, match=rf"^{name}: found .*{quantity.unit}, expected "):
                    effect(PERIOD_S, **{name: value})

    def test_the_tangent_matches_finite_differences_of_the_output(self):
        effect, x, dx = self.operator(), wandering(1, 200), wandering(3, 200, seed=1)
        small = 1e-6
        with torch.no_grad():
            wanted = (effect(x + small * dx)[0] - effect(x - small * dx)[0]) / (2 * small)
        torch.testing.assert_close(effect.tangent(x, dx), wanted, rtol=0, atol=1e-8)

    def test_saved_parameters_are_valid_at_any_sample_rate(self):
        slow, coarse = self.operator(), wandering(1, 200)
        fast = type(slow)(PERIOD_S / 10)
        fast.load_state_dict(slow.state_dict())
        torch.testing.assert_close(fast(finer(coarse))[0][:, ::10], slow(coarse)[0], rtol=0, atol=1e-10)

    def test_a_search_starts_within_the_bounds_and_away_from_the_identity(self):
        effect = type(self.operator())

        @given(seen=recordings)
        def check(seen: DataRange) -> None:
            starts = effect.starts(seen)
            assert len(starts) <= 48
            for start in starts:
                values = effect(1 / seen.fs_hz, **start).values()
                assert {name: values[name] for name in start} == start
                assert values != effect.identity

        check()


def fixed(effect: Effect, *names: str) -> Effect:
    """Return the effect without gradients to these parameters, which belong to another form."""
    for name in names:
        effect.get_parameter(name).requires_grad_(False)
    return effect


def finer(coarse: Tensor) -> Tensor:
    """Return the same straight runs, sampled ten times as finely."""
    steps = torch.arange((coarse.shape[1] - 1) * 10 + 1)
    before, after = coarse[:, steps // 10], coarse[:, (steps // 10 + 1).clamp(max=coarse.shape[1] - 1)]
    return torch.lerp(before, after, (steps % 10).to(coarse) / 10)


def step(time: int) -> Tensor:
    """Return a unit step at the first sample, (1, time)."""
    return torch.ones(1, time, dtype=torch.float64)
