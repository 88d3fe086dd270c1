"""Laws that every operator obeys, as test classes to inherit from.

A test class defines how its operator is built and inherits the tests of the laws:

    class TestPrandtlIshlinskii(HysteresisLaws):
        def operator(self):
            return PrandtlIshlinskii([0.0, 0.5, 1.0], [1.0, -0.3, 0.2])

Nothing but torch is needed; pytest finds the methods by their names.
"""

import copy
import io
import itertools
import warnings
from typing import Any

import torch
from torch import Tensor

from torchpi.operators.base import Operator


def wandering(batch: int, time: int, seed: int = 0) -> Tensor:
    """Return smooth random inputs that reverse often and start at 0; shape (batch, time)."""
    generator = torch.Generator().manual_seed(seed)
    steps = torch.randn(batch, time, dtype=torch.float64, generator=generator)
    kernel = torch.hann_window(15, dtype=torch.float64)[None, None]
    smooth = torch.nn.functional.conv1d(steps[:, None], kernel, padding=7)[:, 0]
    x = smooth.cumsum(1)
    return 2.0 * (x - x[:, :1]) / x.abs().amax(1, keepdim=True)


class OperatorLaws:
    """Laws that hold for every operator."""

    differentiable = True

    def operator(self) -> Operator:
        """Build the operator under test, with its parameters away from special values."""
        raise TypeError(f"{type(self).__name__} must define operator()")

    def test_output_has_the_shape_and_type_of_the_input(self) -> None:
        x = wandering(3, 50)
        y, state = self.operator()(x)
        assert y.shape[:2] == x.shape and y.dtype == x.dtype
        assert state.shape[0] == 3

    def test_batch_rows_do_not_touch_each_other(self) -> None:
        operator, x = self.operator(), wandering(3, 200)
        together = operator(x)[0]
        for row in range(3):
            assert torch.equal(operator(x[row : row + 1])[0][0], together[row])

    def test_windows_with_carried_state_give_the_same_bits_as_one_pass(self) -> None:
        operator, x = self.operator(), wandering(2, 300)
        whole, final = operator(x)
        first, state = operator(x[:, :101])
        second, state = operator(x[:, 101:], state)
        assert torch.equal(torch.cat([first, second], 1), whole)
        assert torch.equal(state, final)

    def test_stream_gives_the_same_bits_as_the_batch(self) -> None:
        operator, x = self.operator(), wandering(1, 400)
        assert torch.equal(streamed(operator.stream(), x), operator(x)[0][0])

    def test_scripted_stream_gives_the_same_bits_and_resets(self) -> None:
        operator, x = self.operator(), wandering(1, 400)
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", message=".*torch.jit.*deprecated.*")
            scripted = torch.jit.script(operator.stream())
        expected = operator(x)[0][0]
        assert torch.equal(streamed(scripted, x), expected)
        scripted.reset()
        assert torch.equal(streamed(scripted, x), expected)

    def test_output_is_causal(self) -> None:
        operator, x = self.operator(), wandering(1, 200)
        altered = x.clone()
        altered[:, 120:] += 1.0
        assert torch.equal(operator(altered)[0][:, :120], operator(x)[0][:, :120])

    def test_saved_parameters_restore_the_same_operator(self) -> None:
        operator, x = self.operator(), wandering(1, 100)
        file = io.BytesIO()
        torch.save(operator.state_dict(), file)
        file.seek(0)
        other = copy.deepcopy(operator)
        for parameter in other.parameters():
            torch.nn.init.constant_(parameter, 0.5)
        other.load_state_dict(torch.load(file, weights_only=True))
        assert torch.equal(other(x)[0], operator(x)[0])

    def test_gradients_are_those_of_finite_differences(self) -> None:
        if not self.differentiable:
            return
        operator = self.operator()
        names, parameters = zip(*operator.named_parameters(), strict=True) if _has(operator) else ((), ())
        x = wandering(2, 12).requires_grad_()
        state = operator.initial_state(2).detach().clone().add_(0.01).requires_grad_()

        def output(x: Tensor, state: Tensor, *values: Tensor) -> tuple[Tensor, Tensor]:
            given = dict(zip(names, values, strict=True))
            y, last = torch.func.functional_call(operator, given, (x, state))
            return y, last

        inputs = (x, state, *(p.detach().clone().requires_grad_(p.requires_grad) for p in parameters))
        assert torch.autograd.gradcheck(output, inputs, eps=1e-7, atol=1e-5)


class HysteresisLaws(OperatorLaws):
    """Additional laws for every rate-independent hysteresis of Prandtl–Ishlinskii type."""

    def test_rate_does_not_matter(self) -> None:
        operator, x = self.operator(), wandering(1, 200)
        slowly = x.repeat_interleave(3, 1)
        assert torch.equal(operator(slowly)[0][:, 2::3], operator(x)[0])

    def test_a_larger_excursion_wipes_out_the_smaller_ones(self) -> None:
        operator = self.operator()
        minor = _path(0.0, 1.0, -0.5, 0.7, -0.2, 2.0, -2.0, 0.4)
        major = _path(0.0, 2.0, -2.0, 0.4)
        assert torch.allclose(operator(minor)[0][:, -1], operator(major)[0][:, -1], rtol=0, atol=1e-12)

    def test_a_closed_minor_loop_returns_to_the_point_where_it_began(self) -> None:
        operator = self.operator()
        start = _path(0.0, 2.0, -1.0)
        loop = _path(0.0, 2.0, -1.0, 0.5, -1.0)
        assert torch.allclose(operator(loop)[0][:, -1], operator(start)[0][:, -1], rtol=0, atol=1e-12)

    def test_minor_loops_between_equal_ends_are_congruent(self) -> None:
        operator = self.operator()
        ends = (-0.5, 0.5, -0.5, 0.5, -0.5)  # once round to close the loop, once to compare it
        below = operator(_path(0.0, -3.0, *ends))[0][:, -201:]
        above = operator(_path(0.0, 3.0, *ends))[0][:, -201:]
        assert torch.allclose(below - below[:, :1], above - above[:, :1], rtol=0, atol=1e-12)


def streamed(stream: Any, x: Tensor) -> Tensor:
    """Step through the only row of `x`; shape (time, …)."""
    step = stream.step
    outputs = []
    for sample in x[0].tolist():
        output = step(sample)
        # A bank hands out its own list of states: copy it before the next step writes into it.
        outputs.append(list(output) if isinstance(output, list) else output)
    return torch.tensor(outputs, dtype=torch.float64)


def _path(*corners: float) -> Tensor:
    """Return straight runs of 100 steps from corner to corner; shape (1, time)."""
    runs = [
        torch.linspace(start, stop, 101, dtype=torch.float64)[(0 if i == 0 else 1) :]
        for i, (start, stop) in enumerate(itertools.pairwise(corners))
    ]
    return torch.cat(runs)[None]


def _has(operator: Operator) -> bool:
    return next(operator.parameters(), None) is not None
