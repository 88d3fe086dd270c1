"""The compensator as it is deployed: one sample a call, plain floats, no tensor.

The step is written out for the compensator at hand, play by play and constant by constant, from the
same scalar equations that the batch kernels compile: what a compensator does not have costs nothing,
and a step takes a quarter of the time of one with its state in tensors (`benchmarks/step_latency.py`).
"""

import itertools
import linecache
from collections.abc import Iterator
from typing import TYPE_CHECKING, Protocol, cast

import torch
from torch import Tensor, nn

from torchpi.errors import ArtifactError
from torchpi.motion import BackwardMotionStream
from torchpi.operators.play import play
from torchpi.operators.rate_weights import squash
from torchpi.operators.reference_filter import ReferenceFilter

if TYPE_CHECKING:
    from torchpi.compensator import DirectInverse


class CompensatorStream(Protocol):
    """What an exported compensator offers; `torch.jit.script` compiles it.

    `step` takes the desired displacement at t + preview, in µm, and returns the voltage at t. `block`
    takes as many samples as it is given, (N,) float64, and leaves the same state. An input that is not
    finite counts in `held_inputs`, and the last finite one stands in for it.
    """

    sample_period_s: float
    preview: int
    min_voltage_v: float
    max_voltage_v: float
    has_reference_filter: bool
    held_inputs: int

    def reset(self) -> None: ...
    def step(self, yd: float) -> float: ...
    def block(self, yd: Tensor) -> Tensor: ...


def compensator_stream(
    compensator: "DirectInverse", reference_filter: ReferenceFilter | None
) -> CompensatorStream:
    """Write the step for this compensator and load it; its text stays readable by `inspect`.

    Raises:
        ArtifactError: A parameter is not finite.
    """
    for name, values in compensator.state_dict().items():
        if not bool(torch.isfinite(values).all()):
            raise ArtifactError(
                f"{name}: found {values.tolist()}, want finite numbers: the training diverged"
            )
    source = step_source(compensator)
    filename = f"<compensator step {next(_serial)}>"
    # TorchScript reads a function's text through linecache, as tracebacks and debuggers do.
    linecache.cache[filename] = (len(source), None, source.splitlines(True), filename)
    namespace = {"torch": torch, "nn": nn, "Tensor": Tensor, "play": play, "squash": squash}
    exec(compile(source, filename, "exec"), namespace)
    motion = (
        BackwardMotionStream(compensator.sample_period_s)
        if reference_filter is None
        else reference_filter.stream()
    )
    written_out = cast(type[nn.Module], namespace["WrittenOut"])
    return cast(CompensatorStream, written_out(motion, reference_filter is not None))


def step_source(compensator: "DirectInverse") -> str:
    """The deployed step of this compensator, as text: eq. 8 with its numbers in place."""
    equations = "\n".join(f"        {line}" for line in _step_lines(compensator))
    states = [f"xi{j}" for j in range(len(compensator.creep_gains))]
    states += [f"h{i}" for i in range(len(compensator.plays.r))]
    cleared = "\n".join(f"        self.{state} = 0.0" for state in states)
    return f"""
class WrittenOut(nn.Module):
    def __init__(self, motion: nn.Module, has_reference_filter: bool) -> None:
        super().__init__()
        self.motion = motion
        self.has_reference_filter = has_reference_filter
        self.sample_period_s = {compensator.sample_period_s!r}
        self.preview = {compensator.preview!r}
        self.min_voltage_v = {compensator.min_voltage_v!r}
        self.max_voltage_v = {compensator.max_voltage_v!r}
        self.last_input = 0.0
        self.held_inputs = 0
{cleared}

    @torch.jit.export
    def reset(self) -> None:
        self.motion.reset()
        self.last_input = 0.0
        self.held_inputs = 0
{cleared}

    @torch.jit.export
    def step(self, yd: float) -> float:
{equations}

    @torch.jit.export
    def block(self, yd: Tensor) -> Tensor:
        u = torch.empty_like(yd)
        for i in range(len(yd)):
            # fill_, because TorchScript rounds to float32 on the way through u[i] = … or torch.tensor.
            u[i].fill_(self.step(float(yd[i])))
        return u
"""


def _step_lines(compensator: "DirectInverse") -> Iterator[str]:
    # x - x is zero for every finite x, and not for inf and nan.
    yield "if yd - yd == 0.0:"
    yield "    self.last_input = yd"
    yield "else:"
    yield "    self.held_inputs += 1"
    yield "x, rate, acceleration = self.motion.step(self.last_input)"
    for tau, derivative in zip(compensator.lead.tolist(), ("rate", "acceleration"), strict=False):
        yield f"x = x + {tau!r} * {derivative}"

    gains, decays = compensator.creep_gains.tolist(), compensator.creep_decay.tolist()
    if gains:
        yield f"crept = {' + '.join(f'{g!r} * self.xi{j}' for j, g in enumerate(gains))}"
        for j, a in enumerate(decays):
            yield f"self.xi{j} = {a!r} * self.xi{j} + {1.0 - a!r} * x"
        yield "x = crept + x"

    coefficients = compensator.saturation.c.tolist()
    horner = f"(0.0 + {coefficients[-1]!r}) * x"
    for c in reversed(coefficients[:-1]):
        horner = f"({horner} + {c!r}) * x"
    yield f"s = {horner}  # eq. 4"

    weights = compensator.weights
    basis = ["1.0"]
    if weights.kind != "none":
        yield f"z = rate / {weights.rate_scale_um_s!r}"
        basis.append("z")
    for j, (a, c) in enumerate(zip(weights.slope.tolist(), weights.shift.tolist(), strict=True)):
        yield f"phi{j} = squash({a!r} * z + {c!r})"
        basis.append(f"phi{j}")

    numbers = zip(compensator.plays.r.tolist(), weights.theta.tolist(), compensator.psi.tolist(), strict=True)
    for i, (r, theta, psi) in enumerate(numbers):
        if r == 0.0:  # this play is its input, whatever its state
            yield f"h{i} = s"
        else:
            yield f"h{i} = play(s, {r!r}, self.h{i})  # eq. 1"
            yield f"self.h{i} = h{i}"
        terms = [f"{theta[0]!r}"] + [f"{t!r} * {phi}" for t, phi in zip(theta[1:], basis[1:], strict=True)]
        if psi:
            yield f"z{i} = h{i} / {compensator.range_um!r}"
            own = f"(0.0 + {psi[-1]!r}) * z{i}"
            for coefficient in reversed(psi[:-1]):
                own = f"({own} + {coefficient!r}) * z{i}"
            terms.append(own)
        yield f"u = {'u + ' if i > 0 else ''}({' + '.join(terms)}) * h{i}  # eq. 7, 8"
    if compensator.offset.item() != 0.0:
        yield f"u = u + {compensator.offset.item()!r}"
    yield "return min(max(u, self.min_voltage_v), self.max_voltage_v)"


_serial = itertools.count()
