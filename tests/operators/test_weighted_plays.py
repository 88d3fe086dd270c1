"""Eq. 8 in one kernel: bits and gradients equal those of the separate operators; threads, compilation."""

import multiprocessing
import subprocess
import sys
import textwrap

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor

from torchpi.operators import RateWeights, play_bank, polynomial, weighted_sum
from torchpi.operators.compiled import in_threads
from torchpi.operators.conformance import wandering
from torchpi.operators.folded import fold_shape
from torchpi.operators.weighted_plays import weighted_plays

SCALES = 3.0, 2.5
NAMES = "x", "rate", "h0", "c", "r", "theta", "knots", "psi", "offset"


def inputs(seed: int, batch: int, time: int, plays: int, functions: int, own: int) -> list[Tensor]:
    generator = torch.Generator().manual_seed(seed)

    def random(*shape: int) -> Tensor:
        return torch.randn(*shape, dtype=torch.float64, generator=generator)

    # Rounded inputs, thresholds and states hit the kinks exactly.
    x, r, h0 = random(batch, time).cumsum(1).round(decimals=1), random(plays).abs(), random(batch, plays)
    c = torch.tensor([1.0, 0.05, -0.002], dtype=torch.float64)
    knots = random(max(functions - 2, 0), 2)
    return [
        x,
        random(batch, time),
        h0.round(decimals=1),
        c,
        3 * r.round(decimals=1),
        random(plays, functions),
        knots,
        random(plays, own),
        random(()),
    ]


def one_after_the_other(
    x: Tensor,
    rate: Tensor,
    h0: Tensor,
    c: Tensor,
    r: Tensor,
    theta: Tensor,
    knots: Tensor,
    psi: Tensor,
    offset: Tensor,
) -> tuple[Tensor, Tensor]:
    kind = {1: "none", 2: "linear"}.get(theta.shape[1], "neural")
    head = RateWeights([0.0] * len(r), kind, SCALES[0], max(len(knots), 1))
    values = {"slope": knots[:, 0], "shift": knots[:, 1]}
    basis = torch.func.functional_call(_Basis(head), {f"head.{k}": v for k, v in values.items()}, (rate,))
    h = play_bank(polynomial(x, list(c)), r, h0)
    return weighted_sum(h, basis, theta, psi, SCALES[1]) + offset, h[:, -1]


class _Basis(torch.nn.Module):
    def __init__(self, head: RateWeights) -> None:
        super().__init__()
        self.head = head

    def forward(self, rate: Tensor) -> Tensor:
        return self.head.basis(rate)


@given(
    seed=st.integers(0, 10**6),
    batch=st.integers(1, 3),
    time=st.integers(1, 400),
    plays=st.integers(1, 9),
    functions=st.integers(1, 4),
    own=st.integers(0, 2),
)
def test_bits_and_gradients_match_those_of_the_separate_operators(
    seed: int, batch: int, time: int, plays: int, functions: int, own: int
) -> None:
    parts = [part.requires_grad_() for part in inputs(seed, batch, time, plays, functions, own)]
    fused, plain = weighted_plays(*parts, *SCALES), one_after_the_other(*parts)
    assert all(torch.equal(one, other) for one, other in zip(fused, plain, strict=True))
    upstream = tuple(wandering(len(part), part.shape[1], seed).add(1.0) for part in fused)
    for name, one, other in zip(
        NAMES,
        torch.autograd.grad(fused, parts, upstream, allow_unused=True, materialize_grads=True),
        torch.autograd.grad(plain, parts, upstream, allow_unused=True, materialize_grads=True),
        strict=True,
    ):
        if name == "r":
            # A threshold cannot fall below 0; at 0 both edges push, and either gradient is valid.
            one, other = one[parts[4] > 0], other[parts[4] > 0]
        largest = float(other.abs().amax()) if other.numel() else 0.0
        assert torch.allclose(one, other, rtol=0, atol=1e-11 * (1 + largest)), name


@pytest.mark.parametrize("amplitude", [0.3, 40.0])
def test_a_record_cut_into_many_groups_gives_the_same_result(amplitude: float) -> None:
    # With the small amplitude, most plays stay still throughout a stretch; with the large one, all move.
    samples = 120_000
    assert fold_shape(samples)[0] > 1
    parts = inputs(1, 1, samples, 5, 2, 0)
    parts[0] = amplitude * wandering(1, samples)
    parts = [part.requires_grad_() for part in parts]
    fused, plain = weighted_plays(*parts, *SCALES), one_after_the_other(*parts)
    assert all(torch.equal(one, other) for one, other in zip(fused, plain, strict=True))
    gradients = (
        torch.autograd.grad(u.square().mean() + h.sum(), parts, allow_unused=True) for u, h in (fused, plain)
    )
    for one, other in zip(*gradients, strict=True):
        if one is not None and one.numel():
            assert torch.allclose(one, other, rtol=1e-9, atol=1e-9 * float(other.abs().amax()))


def test_gradients_match_finite_differences() -> None:
    parts = [part.requires_grad_() for part in inputs(4, 2, 9, 3, 4, 2)]
    with torch.no_grad():
        parts[0] += 0.0137 * torch.randn_like(parts[0])  # away from the kinks
    assert torch.autograd.gradcheck(lambda *p: weighted_plays(*p, *SCALES), parts, eps=1e-7, atol=1e-4)


def test_float32_is_kept_and_close_to_float64() -> None:
    parts = inputs(0, 2, 500, 6, 4, 2)
    exact, _ = weighted_plays(*parts, *SCALES)
    u, h = weighted_plays(*(part.float() for part in parts), *SCALES)
    assert u.dtype == h.dtype == torch.float32
    assert torch.allclose(u.double(), exact, rtol=1e-4, atol=1e-4 * float(exact.abs().amax()))


def _outcome(threads: int) -> list[Tensor]:
    torch.set_num_threads(threads)
    parts = [part.requires_grad_() for part in inputs(2, 2, 110_000, 4, 4, 2)]
    u, h = weighted_plays(*parts, *SCALES)
    states = play_bank(parts[0], parts[4], parts[2])
    gradients = torch.autograd.grad(u.square().sum() + h.sum() + states.square().sum(), parts)
    return [part.detach() for part in (u, h, states, *gradients)]


def test_any_number_of_threads_gives_the_same_bits() -> None:
    one = _outcome(1)
    for threads in (2, 5):
        assert all(torch.equal(*pair) for pair in zip(_outcome(threads), one, strict=True))


@pytest.mark.filterwarnings("ignore:.*fork.*:DeprecationWarning")
def test_a_forked_process_starts_threads_of_its_own() -> None:
    # As in a data loader: the child has none of the threads that its parent has started.
    assert _counted_in_threads() == list(range(7))
    with multiprocessing.get_context("fork").Pool(1) as pool:
        assert pool.apply_async(_counted_in_threads).get(20) == list(range(7))


def _counted_in_threads() -> list[int]:
    torch.set_num_threads(3)
    done = np.zeros(7, int)

    def kernel(first: int, last: int) -> None:
        done[first:last] = range(first, last)

    in_threads(kernel, 7)
    return done.tolist()


def test_both_operations_pass_the_checks_of_torch_library() -> None:
    parts = [part.requires_grad_() for part in inputs(0, 2, 40, 3, 4, 1)]
    checks = "test_schema", "test_autograd_registration", "test_faketensor"
    torch.library.opcheck(torch.ops.torchpi.weighted_plays.default, (*parts, *SCALES), test_utils=checks)
    torch.library.opcheck(
        torch.ops.torchpi.play_bank.default, (parts[0], parts[4], parts[2]), test_utils=checks
    )


def test_without_the_dispatcher_the_bits_are_the_same() -> None:
    parts = [part.requires_grad_() for part in inputs(0, 2, 60, 3, 4, 1)]
    eager = weighted_plays(*parts, *SCALES)
    dispatched = torch.ops.torchpi.weighted_plays(*parts, *SCALES)[:2]
    for one, other in zip(eager, dispatched, strict=True):
        assert torch.equal(one, other)
    for one, other in zip(
        torch.autograd.grad(sum(part.square().sum() for part in eager), parts),
        torch.autograd.grad(sum(part.square().sum() for part in dispatched), parts),
        strict=True,
    ):
        assert torch.equal(one, other)


def test_torch_compile_captures_them_whole_forward_and_backward() -> None:
    parts = [part.requires_grad_() for part in inputs(0, 2, 60, 3, 4, 1)]

    def loss(*parts: Tensor) -> Tensor:
        u, h = weighted_plays(*parts, *SCALES)
        return u.square().sum() + h.sum() + play_bank(parts[0], parts[4], parts[2]).square().sum()

    compiled = torch.compile(loss, backend="aot_eager", fullgraph=True)
    for one, other in zip(
        torch.autograd.grad(compiled(*parts), parts), torch.autograd.grad(loss(*parts), parts), strict=True
    ):
        assert torch.equal(one, other)


def test_without_numba_plain_torch_gives_the_same_voltage() -> None:
    # A fresh interpreter hides numba from the module that imports it.
    program = """
        import builtins
        real = builtins.__import__
        def hidden(name, globals=None, *rest):
            if name == "numba" and globals["__name__"] == "torchpi.operators.compiled":
                raise ImportError(name)
            return real(name, globals, *rest)
        builtins.__import__ = hidden
        import sys
        import torch
        from torchpi.control.direct_inverse import DirectInverse
        from torchpi.operators.motion import backward_motion
        from torchpi.operators import compiled
        assert not compiled.HAS_COMPILER
        made = DirectInverse(1e-3, [0.0, 0.1, 0.4], rate="neural", output_degree=2)
        with torch.no_grad():
            made.weights.theta += torch.linspace(-1, 1, 18, dtype=torch.float64).reshape(3, 6)
            made.psi += 0.3
        yd = torch.sin(0.1 * torch.arange(200, dtype=torch.float64))
        u = made.voltage(backward_motion(yd[None], 1e-3))[0]
        u.sum().backward()
        made.min_voltage_v, made.max_voltage_v = -1e9, 1e9
        print(torch.equal(u[0], made.stream().block(yd)))
    """
    done = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(program)], capture_output=True, text=True, check=False
    )
    assert done.stdout.strip() == "True", done.stderr


@settings(max_examples=5)
@given(seed=st.integers(0, 10**6))
def test_gradients_may_be_requested_for_a_single_input(seed: int) -> None:
    parts = inputs(seed, 1, 50, 3, 4, 1)
    everything = [part.clone().requires_grad_() for part in parts]
    full = torch.autograd.grad(weighted_plays(*everything, *SCALES)[0].sum(), everything)
    for k, name in enumerate(NAMES):
        some = [part.clone().requires_grad_(j == k) for j, part in enumerate(parts)]
        (alone,) = torch.autograd.grad(weighted_plays(*some, *SCALES)[0].sum(), [some[k]])
        assert torch.equal(alone, full[k]), name
