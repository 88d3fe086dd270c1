"""Modes driven by several inputs: superposition, the same bits from every kernel, sensitivities."""

from typing import Any

import pytest
import torch
from torch import Tensor

from torchpi.errors import StageError
from torchpi.operators.conformance import OperatorLaws, wandering
from torchpi.stage.effects.mechanics.cross_coupling import CrossCoupling
from torchpi.stage.effects.mechanics.modal import ModalCoupling, ModalResonance, ModalSecondMode
from torchpi.stage.effects.mechanics.modes import Modes, Part
from torchpi.stage.effects.mechanics.resonance import Resonance
from torchpi.stage.effects.mechanics.second_mode import SecondMode

PERIOD_S = 1e-3
FIRST = Part(ModalResonance, {"frequency_hz": 90.0, "damping_ratio": 0.02, "share": 0.7, "rate_share": -0.1})
SECOND = Part(ModalSecondMode, {"frequency_hz": 200.0, "damping_ratio": 0.05, "share": -0.2})
COUPLED = {
    "coupling_um_per_v": 0.3,
    "mode1_um_per_v": 0.2,
    "mode2_um_per_v": -0.1,
    "mode2_rate_um_per_v": 0.05,
}
OTHER = Part(ModalCoupling, COUPLED, "aux_a")
PARTS = [OTHER, FIRST, SECOND]


class TestLaws(OperatorLaws):
    def operator(self) -> Modes:
        return Modes(PERIOD_S, PARTS)


def test_one_mode_parallel_to_the_stiff_path_equals_a_second_mode():
    x, values = wandering(2, 300), {"frequency_hz": 90.0, "damping_ratio": 0.02, "share": 0.3}
    wanted = SecondMode(PERIOD_S, **values)(x)[0]
    torch.testing.assert_close(
        Modes(PERIOD_S, [Part(ModalSecondMode, values)])(x)[0], wanted, rtol=0, atol=1e-12
    )


def test_inputs_and_modes_superpose():
    x, a = wandering(2, 300), wandering(2, 300, seed=1)

    def mode(u: Tensor, part: Part) -> Tensor:
        f, damping = part.values["frequency_hz"], part.values["damping_ratio"]
        return Resonance(PERIOD_S, frequency_hz=f, damping_ratio=damping)(u)[0]

    still = [Part(effect, {**values, "rate_share": 0.0}) for effect, values, _ in PARTS[1:]]
    coupling = Part(ModalCoupling, {**COUPLED, "mode2_rate_um_per_v": 0.0}, "aux_a")
    y = Modes(PERIOD_S, [coupling, *still])(x, None, [a])[0]
    own = x + 0.7 * (mode(x, FIRST) - x) - 0.2 * (mode(x, SECOND) - x)
    wanted = own + 0.3 * a + 0.2 * (mode(a, FIRST) - a) - 0.1 * (mode(a, SECOND) - a)
    torch.testing.assert_close(y, wanted, rtol=0, atol=1e-11)


def test_without_modes_a_coupling_equals_a_cross_coupling():
    x, a = wandering(2, 30), wandering(2, 30, seed=1)
    modes = Modes(PERIOD_S, [Part(ModalCoupling, {"coupling_um_per_v": 0.3}, "aux_a")])
    y = modes(x, None, [a])[0]
    assert torch.equal(y, CrossCoupling(PERIOD_S, coupling_um_per_v=0.3)(x, None, a)[0])
    with torch.no_grad():
        assert torch.equal(modes(x, None, [a])[0], y)
    slope = modes.slopes(x[:1], [a[:1]])[0, "coupling_um_per_v"]
    torch.testing.assert_close(slope, a[:1], rtol=0, atol=1e-12)


@pytest.mark.parametrize("hold", ["first", "end"])
def test_the_output_has_the_same_bits_with_and_without_gradients(hold):
    modes, x, a = Modes(PERIOD_S, PARTS), wandering(11, 200), wandering(11, 200, seed=1)
    modes.hold = hold
    y, state = modes(x, None, [a])
    with torch.no_grad():
        first, between = modes(x[:, :77], None, [a[:, :77]])
        second, after = modes(x[:, 77:], between, [a[:, 77:]])
    assert torch.equal(torch.cat([first, second], 1), y) and torch.equal(after, state)


def test_gradients_match_finite_differences():
    modes, x, a = Modes(PERIOD_S, PARTS), wandering(1, 25), wandering(1, 25, seed=1)
    names = [name for name, _ in modes.named_parameters()]

    def output(x: Tensor, a: Tensor, *numbers: Tensor) -> Any:
        return torch.func.functional_call(modes, dict(zip(names, numbers, strict=True)), (x, None, [a]))[0]

    inputs = [part.detach().clone().requires_grad_() for part in (x, a, *modes.parameters())]
    assert torch.autograd.gradcheck(output, inputs)


def test_slopes_match_finite_differences_in_each_parameter():
    x, a = wandering(1, 200), wandering(1, 200, seed=1)
    slopes = Modes(PERIOD_S, PARTS).slopes(x, [a])
    assert {name for part, name in slopes if part == 0} == ModalCoupling.of_modes([1, 2])
    for (place, name), slope in slopes.items():
        part, ends = PARTS[place], []
        value = part.values.get(name, 0.0)
        step = 1e-5 * max(1.0, abs(value))
        for end in (value + step, value - step):
            parts = [*PARTS]
            parts[place] = part._replace(values={**part.values, name: end})
            ends.append(Modes(PERIOD_S, parts)(x, None, [a])[0].detach())
        wanted = (ends[0] - ends[1]) / (2 * step)
        torch.testing.assert_close(slope, wanted, rtol=0, atol=2e-4 * float(wanted.abs().max()))


def test_parts_are_read_back_without_parameters_of_absent_modes():
    modes = Modes(PERIOD_S, PARTS)
    assert modes.part_values(0) == {"mode1_rate_um_per_v": 0.0, **COUPLED}
    assert modes.part_values(2) == {"rate_share": 0.0, **SECOND.values}
    assert "mode1_um_per_v" not in Modes(PERIOD_S, [OTHER, SECOND]).part_values(0)


def test_a_parameter_out_of_bounds_or_unknown_is_named_in_the_error():
    with pytest.raises(StageError, match=r"^damping_ratio: found 2, expected"):
        Modes(PERIOD_S, [Part(ModalResonance, {"damping_ratio": 2.0})])
    with pytest.raises(StageError, match="gain"):
        Modes(PERIOD_S, [Part(ModalResonance, {"gain": 2.0})])
