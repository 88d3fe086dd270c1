"""Linear blocks: discretisation compared with scipy and control, the kernel with the recursion."""

import control
import numpy as np
import pytest
import scipy.signal
import torch
from hypothesis import given
from hypothesis import strategies as st
from torch import Tensor

from torchpi.operators.conformance import OperatorLaws, wandering
from torchpi.operators.linear import Matrices, discretise, state_space
from torchpi.stage.effects.effect import StateSpaceEffect


class Third(StateSpaceEffect):
    """A lag and a mode in one dense block with direct feedthrough."""

    order = 3

    def __init__(self) -> None:
        super().__init__(sample_period_s=0.2)
        a = [[-1.0, 0.4, 0.1], [0.0, -0.1, 2.0], [0.3, -2.0, -0.1]]
        self.a = torch.nn.Parameter(torch.tensor(a, dtype=torch.float64))

    def continuous(self) -> Matrices:
        b, c = torch.tensor([[1.0, 0.0, 0.5], [0.2, 1.0, -0.7]], dtype=torch.float64)
        return self.a, b, c, torch.tensor(0.3, dtype=torch.float64)

    def matrices(self) -> Matrices:
        return discretise(*self.continuous(), self.sample_period_s, "first")


class TestLaws(OperatorLaws):
    def operator(self) -> Third:
        return Third()


@st.composite
def systems(draw: st.DrawFn) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
    n = draw(st.integers(1, 4))
    random = np.random.default_rng(draw(st.integers(0, 10**6)))
    a = random.normal(size=(n, n)) - 1.5 * np.eye(n)
    return a, random.normal(size=n), random.normal(size=n), float(random.normal())


def as_tensors(*arrays: np.ndarray | float) -> list[Tensor]:
    return [torch.tensor(array, dtype=torch.float64) for array in arrays]


def zeros(*shape: int) -> Tensor:
    return torch.zeros(*shape, dtype=torch.float64)


@pytest.mark.parametrize("hold", ["zero", "first"])
@given(system=systems(), period_s=st.floats(1e-3, 2.0))
def test_discretisation_matches_scipy(hold, system, period_s):
    a, b, c, d = system
    found = discretise(*as_tensors(a, b, c, d), period_s, hold)
    method = {"zero": "zoh", "first": "foh"}[hold]
    wanted = scipy.signal.cont2discrete((a, b[:, None], c[None], np.array([[d]])), period_s, method)
    for ours, theirs in zip(found, wanted[:4], strict=True):
        np.testing.assert_allclose(ours.numpy().ravel(), theirs.ravel(), rtol=1e-9, atol=1e-11)


@pytest.mark.parametrize("hold", ["zero", "first"])
def test_several_blocks_are_discretised_at_once(hold):
    random = np.random.default_rng(1)
    blocks = as_tensors(
        random.normal(size=(5, 2, 2)),
        random.normal(size=(5, 2)),
        random.normal(size=(5, 2)),
        random.normal(size=5),
    )
    together = discretise(*blocks, 0.1, hold)
    for i in range(5):
        alone = discretise(*(part[i] for part in blocks), 0.1, hold)
        for one, all_of_them in zip(alone, together, strict=True):
            torch.testing.assert_close(all_of_them[i], one, rtol=1e-13, atol=1e-15)


@given(system=systems(), seed=st.integers(0, 10**6))
def test_response_matches_scipy_and_control_for_an_input_that_starts_at_zero(system, seed):
    a, b, c, d = system
    u = np.r_[0.0, np.random.default_rng(seed).normal(size=60)]
    t = 0.05 * np.arange(len(u))
    for hold, interpolated in (("zero", False), ("first", True)):
        matrices = discretise(*as_tensors(a, b, c, d), 0.05, hold)
        y, _ = state_space(torch.tensor(u)[None], *matrices, zeros(1, len(b)))
        _, wanted, _ = scipy.signal.lsim((a, b[:, None], c[None], [[d]]), u, t, interp=interpolated)
        np.testing.assert_allclose(y[0].numpy(), wanted, rtol=1e-9, atol=1e-9)
    theirs = control.forced_response(control.ss(a, b[:, None], c[None], [[d]]), t, u).outputs
    np.testing.assert_allclose(y[0].numpy(), theirs, rtol=1e-8, atol=1e-8)


@given(system=systems(), factor=st.sampled_from([2, 3, 10]))
def test_one_set_of_physical_parameters_is_valid_at_any_sample_rate(system, factor):
    coarse = wandering(1, 40)
    steps = torch.arange(39 * factor + 1)
    share = (steps % factor) / factor
    before, after = coarse[:, steps // factor], coarse[:, (steps // factor + 1).clamp(max=39)]
    finer = {"zero": before, "first": before + share * (after - before)}
    for hold, fine in finer.items():
        outputs = []
        for period_s, u in ((0.1, coarse), (0.1 / factor, fine)):
            matrices = discretise(*as_tensors(*system), period_s, hold)
            y, _ = state_space(u, *matrices, zeros(1, len(system[1])))
            outputs.append(y)
        torch.testing.assert_close(outputs[1][:, ::factor], outputs[0], rtol=1e-8, atol=1e-8)


def test_kernel_matches_the_textbook_recursion():
    a, b, c, d = discretise(*Third().continuous(), 0.2, "first")
    u, x = wandering(2, 50), torch.ones(2, 3, dtype=torch.float64)
    y, final = state_space(u, a, b, c, d, x)
    for t in range(50):
        torch.testing.assert_close(x @ c + d * u[:, t], y[:, t], rtol=1e-12, atol=1e-12)
        x = x @ a.T + u[:, t : t + 1] * b
    torch.testing.assert_close(x, final, rtol=1e-12, atol=1e-12)


def test_gradients_to_every_argument_are_exact():
    arguments = [part.detach().clone().requires_grad_() for part in Third().matrices()]
    u, x0 = wandering(2, 9).requires_grad_(), torch.rand(2, 3, dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(state_space, (u, *arguments, x0))


def test_gradient_to_the_input_needs_no_gradient_to_the_matrices():
    matrices = [part.detach() for part in Third().matrices()]
    u = wandering(2, 9).requires_grad_()
    assert torch.autograd.gradcheck(lambda u: state_space(u, *matrices, zeros(2, 3)), (u,))


def test_discretisation_passes_exact_gradients():
    continuous = [part.detach().clone().requires_grad_() for part in Third().continuous()]
    for hold in ("zero", "first"):
        assert torch.autograd.gradcheck(lambda *parts, hold=hold: discretise(*parts, 0.2, hold), continuous)


def test_float32_is_computed_in_float64():
    block, x = Third(), wandering(2, 100)
    single, _ = block(x.float())
    assert single.dtype == torch.float32
    torch.testing.assert_close(single, block(x.float().double())[0].float(), rtol=0, atol=0)


def test_a_window_may_be_strided_or_of_one_sample():
    block, x = Third(), wandering(4, 100)
    whole = block(x[::2])[0]
    state, ys = None, []
    for t in range(100):
        y, state = block(x[::2, t : t + 1], state)
        ys.append(y)
    assert torch.equal(torch.cat(ys, 1), whole)
