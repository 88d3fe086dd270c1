"""The compensator as it is deployed: one sample a call, plain floats, no tensor.

The step is written out for the compensator at hand, play by play and constant by constant, from the
same scalar equations that the batch kernels compile: what a compensator does not have costs nothing,
and a step takes a quarter of the time of one with its state in tensors (`benchmarks/step_latency.py`).
"""

import hashlib
import linecache
from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING, Protocol, cast

import torch
from torch import Tensor, nn

from torchpi.control.step_guard import GuardedStep, StepLimits
from torchpi.errors import ArtifactError
from torchpi.operators.motion import BackwardMotionStream
from torchpi.operators.play import play
from torchpi.operators.rate_weights import squash
from torchpi.operators.reference_filter import ReferenceFilter

if TYPE_CHECKING:
    from torchpi.control.direct_inverse import DirectInverse


class CompensatorStream(Protocol):
    """What an exported compensator offers; `torch.jit.script` compiles it.

    `step` takes the desired displacement at t + preview, in µm, and returns the voltage at t. `block`
    takes as many samples as it is given, (N,) float64, and leaves the same state. `reset_at` starts from a
    measured displacement, `reset_at_voltage` from a measured voltage. The guard of every step, and what the
    counters count, is in `torchpi.control.step_guard`.
    """

    sample_period_s: float
    preview: int
    min_voltage_v: float
    max_voltage_v: float
    has_reference_filter: bool
    held_inputs: int
    outside_range: int
    limited_outputs: int

    def reset(self) -> None: ...
    def reset_at(self, yd: float) -> float: ...
    def reset_at_voltage(self, voltage_v: float) -> float: ...
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
                f"{name}: found {values.tolist()}, expected finite numbers: the training diverged"
            )
    limits = compensator.step_limits()
    source = step_source(compensator, limits, reference_filter is not None)
    # By its content, so that equal compensators leave equal files.
    filename = f"<compensator step {hashlib.sha256(source.encode()).hexdigest()[:16]}>"
    # TorchScript reads a function's text through linecache, as tracebacks and debuggers do.
    linecache.cache[filename] = (len(source), None, source.splitlines(True), filename)
    namespace = {"torch": torch, "nn": nn, "GuardedStep": GuardedStep, "play": play, "squash": squash}
    exec(compile(source, filename, "exec"), namespace)
    motion = (
        BackwardMotionStream(compensator.sample_period_s)
        if reference_filter is None
        else reference_filter.stream()
    )
    written_out = cast(type[nn.Module], namespace["WrittenOut"])
    return cast(CompensatorStream, written_out(limits, motion, reference_filter is not None))


def step_source(compensator: "DirectInverse", limits: StepLimits, filters: bool) -> str:
    """The deployed step of this compensator, as text: eq. 8, and its numbers by name and unit.

    Args:
        compensator: What is written out.
        limits: Of its guard.
        filters: Whether a reference filter stands before it.
    """
    constants = _Constants()
    step = _indented(_step_lines(compensator, limits, filters, constants))
    law = _indented(_law_lines(compensator, constants))
    at_rest = _indented(_at_rest_lines(compensator, constants))
    states = [f"xi{j}" for j in range(len(compensator.creep_gains))]
    states += [f"h{i}" for i in range(len(compensator.plays.r))]
    clears = [f"self.{state} = 0.0" for state in states]
    if compensator.lead_limits() is not None:
        clears.append("self.last_x = self.start_um")
    cleared = _indented(clears)
    return f"""
class WrittenOut(GuardedStep):
    '''The direct inverse of eq. 8, one sample at a time.'''

    def __init__(self, limits, motion: nn.Module, has_reference_filter: bool) -> None:
        super().__init__(limits)
        self.motion = motion
        self.has_reference_filter = has_reference_filter
        self.sample_period_s = {compensator.sample_period_s!r}
        self.preview = {compensator.preview!r}
{constants}
{cleared}

    @torch.jit.export
    def reset(self) -> None:
        self.reset_guard()
        self.motion.reset()
{cleared}

    @torch.jit.export
    def step(self, yd: float) -> float:
{step}

    def at_rest(self, yd: float) -> float:
        # The states of a stage that has come from rest to yd and stood there, and the voltage.
        self.motion.reset_at(yd)
{at_rest}

    def law(self, x: float, rate: float) -> float:
{law}
"""


def _indented(lines: Iterable[str]) -> str:
    return "\n".join(f"        {line}" for line in lines)


class _Constants:
    """The numbers of a step: called with one, it gives the name by which the equations take it."""

    def __init__(self) -> None:
        self.lines: dict[str, str] = {}

    def __call__(self, name: str, value: float, comment: str) -> str:
        # Plain ASCII, because the comments go into C as well.
        self.lines[name] = f"        self.{name} = {value!r}  # {comment}"
        return f"self.{name}"

    def __str__(self) -> str:
        return "\n".join(self.lines.values())


def _step_lines(
    compensator: "DirectInverse", limits: StepLimits, filters: bool, constant: _Constants
) -> Iterator[str]:
    yield "self.accept(yd)"
    yield "x, rate, acceleration = self.motion.step(self.last_input)"
    leads = (("rate", "s"), ("acceleration", "s^2"))
    lead_um = compensator.lead_limits()
    if lead_um is not None:
        least = constant("least_lead_um", lead_um[0], "um, least lead of the trained rates and accelerations")
        largest = constant("largest_lead_um", lead_um[1], "um, largest lead of these")
        yield f"least_x = x + {least}"
        yield f"largest_x = x + {largest}"
    if len(compensator.scaled_lead) > 0:
        yield "if self.smooth >= 4:"
    for i, (tau, (derivative, unit)) in enumerate(zip(compensator.lead.tolist(), leads, strict=False), 1):
        yield f"    x = x + {constant(f'tau_{i}', tau, f'{unit}, lead on the {derivative}')} * {derivative}"
    if lead_um is not None:
        # Without a lead, x might pass the turning points of the motion, which wide plays never forget.
        yield "else:"
        yield "    x = self.last_x"
        yield "x = min(max(x, least_x), largest_x)"
        yield "self.last_x = x"
    if filters or (len(compensator.scaled_lead) > 0 and lead_um is None):
        low, high = limits.accepted_um
        least = constant("least_x_um", 2 * low - high, "um, what leads and filter make of a jump")
        largest = constant("largest_x_um", 2 * high - low, "um")
        yield f"x = min(max(x, {least}), {largest})"
    if len(compensator.creep_gains) > 0:
        yield f"crept = {_crept(compensator, constant)}"
        for j, a in enumerate(compensator.creep_decay.tolist()):
            kept = constant(f"kept_{j}", a, f"1, what relaxation {j} keeps in one period")
            taken = constant(f"taken_{j}", 1.0 - a, f"1, what relaxation {j} takes up in one period")
            yield f"self.xi{j} = {kept} * self.xi{j} + {taken} * x"
        yield "x = crept + x"
    yield "self.emit(self.law(x, rate))"
    yield "return self.last_voltage"


def _crept(compensator: "DirectInverse", constant: _Constants) -> str:
    gains = compensator.creep_gains.tolist()
    shares = [
        f"{constant(f'g_{j}', g, f'1, share of relaxation {j} in creep')} * self.xi{j}"
        for j, g in enumerate(gains)
    ]
    return " + ".join(shares)


def _at_rest_lines(compensator: "DirectInverse", constant: _Constants) -> Iterator[str]:
    yield "x = yd"
    if compensator.lead_limits() is not None:
        yield "self.last_x = yd"
    for i in range(len(compensator.plays.r)):
        yield f"self.h{i} = 0.0"
    if len(compensator.creep_gains) > 0:
        for j in range(len(compensator.creep_gains)):
            yield f"self.xi{j} = x"
        yield f"x = {_crept(compensator, constant)} + x"
    yield "return self.law(x, 0.0)"


def _law_lines(compensator: "DirectInverse", constant: _Constants) -> Iterator[str]:
    coefficients = [
        constant(f"c_{i}", c, f"{f'um^{1 - i}' if i > 1 else '1'}, polynomial, eq. 4")
        for i, c in enumerate(compensator.saturation.c.tolist(), 1)
    ]
    yield f"s = {_horner(coefficients, 'x')}  # eq. 4"

    weights = compensator.weights
    basis = []
    if weights.kind != "none":
        yield f"z = rate / {constant('rate_scale_um_s', weights.rate_scale_um_s, 'um/s, unit of the rates')}"
        basis.append("z")
    for j, (a, c) in enumerate(zip(weights.slope.tolist(), weights.shift.tolist(), strict=True)):
        slope = constant(f"slope_{j}", a, f"1, function {j} of the rate")
        shift = constant(f"shift_{j}", c, f"1, function {j} of the rate")
        yield f"phi{j} = squash({slope} * z + {shift})"
        basis.append(f"phi{j}")

    if compensator.psi.numel() > 0:
        range_um = constant("range_um", compensator.range_um, "um, unit of the plays' own output functions")
    numbers = zip(compensator.plays.r.tolist(), weights.theta.tolist(), compensator.psi.tolist(), strict=True)
    yield "u = 0.0"
    for i, (r, theta, psi) in enumerate(numbers):
        threshold = constant(f"r_{i}", r, f"um, threshold of play {i}, eq. 1")
        yield f"h{i} = play(s, {threshold}, self.h{i})  # eq. 1"
        yield f"self.h{i} = h{i}"
        terms = [constant(f"theta_{i}_0", theta[0], f"V/um, weight of play {i} at rest, eq. 7")]
        for q, (value, function) in enumerate(zip(theta[1:], basis, strict=True), 1):
            name = constant(f"theta_{i}_{q}", value, f"V/um, weight of play {i} times {function}, eq. 7")
            terms.append(f"{name} * {function}")
        if psi:
            yield f"v{i} = h{i} / {range_um}"
            own = [
                constant(f"psi_{i}_{q}", value, f"V/um, own output function of play {i}, power {q}")
                for q, value in enumerate(psi, 1)
            ]
            terms.append(_horner(own, f"v{i}"))
        yield f"u = u + ({' + '.join(terms)}) * h{i}  # eq. 7, 8"
    if compensator.offset.item() != 0.0:
        yield f"u = u + {constant('u_0', compensator.offset.item(), 'V, offset')}"
    yield "return u"


def _horner(coefficients: list[str], x: str) -> str:
    text = f"{coefficients[-1]} * {x}"
    for coefficient in reversed(coefficients[:-1]):
        text = f"({text} + {coefficient}) * {x}"
    return text
