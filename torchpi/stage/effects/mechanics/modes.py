"""Modes that several inputs drive, each with its own residue: modal superposition.

    y = x + Σ_i c_i a_i + Σ_m [ s_m (M_m(x) - x) + v_m Ṁ_m(x)/ω_m ]
          + Σ_i Σ_m [ r_im (M_m(a_i) - a_i) + q_im Ṁ_m(a_i)/ω_m ]

M_m is a mode of unit static gain, a_i an auxiliary signal. The poles belong to the structure and are the same
for every input; only the residues depend on the input (Ewins, *Modal Testing*, 2nd ed., 2000, ch. 2;
Preumont, *Vibration Control of Active Structures*, ch. 2). The part in the rate makes a residue complex, as
non-proportional damping or the delay of an input requires. c_i is the static gain from an input, and that
from x is 1.
"""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor, nn

from torchpi.operators.linear import Hold, LinearStream, Matrices, discretise, state_space
from torchpi.operators.superposed_modes import mode_states, superposed
from torchpi.stage.effects.effect import LinearEffect, Parameters
from torchpi.stage.effects.mechanics.modal import ModalCoupling, ModalEffect, ModalResonance, mode_numbers

RELATIVE_STEP = 1e-6
"""Relative step of a finite difference in a frequency or a damping ratio."""


class Part(NamedTuple):
    """One named part, and the signal that it takes, if any."""

    effect: type[ModalEffect]
    values: Parameters
    aux: str = ""


class Place(NamedTuple):
    """The position of a part's parameter in the tensors of `Modes`."""

    part: int
    name: str
    tensor: str
    at: tuple[int, ...]


class Modes(LinearEffect):
    """Every mode side by side, linear in the displacement of the ceramic and in the auxiliary signals.

    Args:
        sample_period_s: T.
        parts: Its parts: modes, and one coupling for each auxiliary signal.
    """

    name = "modes"
    block = "mechanics"
    hold: Hold = "first"

    def __init__(self, sample_period_s: float, parts: Sequence[Part]) -> None:
        super().__init__(sample_period_s)
        for effect, values, _ in parts:
            effect.checked(values)
        self.places = places(parts)
        self.aux_names = tuple(part.aux for part in parts if part.effect is ModalCoupling)
        modes, inputs = sum(issubclass(part.effect, ModalResonance) for part in parts), len(self.aux_names)
        sizes = {
            "frequency_hz": (modes,),
            "damping_ratio": (modes,),
            "share": (1 + inputs, modes),  # row 0: of x
            "rate_share": (1 + inputs, modes),
            "coupling_um_per_v": (inputs,),
        }
        numbers = {name: np.zeros(size) for name, size in sizes.items()}
        for k, name, tensor, at in self.places:
            numbers[tensor][at] = parts[k].values.get(name, parts[k].effect.identity[name])
        for name, each in numbers.items():
            self.register_parameter(name, nn.Parameter(torch.from_numpy(each)))

    frequency_hz: nn.Parameter
    damping_ratio: nn.Parameter
    share: nn.Parameter
    rate_share: nn.Parameter
    coupling_um_per_v: nn.Parameter

    def part_values(self, part: int) -> Parameters:
        """Return the present parameters of a part."""
        return {
            name: self.get_parameter(tensor)[at].item() for k, name, tensor, at in self.places if k == part
        }

    def initial_state(self, batch: int) -> Tensor:
        return torch.zeros(batch, 2 * self.share.numel(), dtype=torch.float64)

    def forward(
        self,
        x: Tensor,  # (batch, time), µm
        state: Tensor | None = None,  # (batch, 2 inputs modes), µm
        aux: Sequence[Tensor] = (),  # (batch, time) each, V; without any they are at rest
    ) -> tuple[Tensor, Tensor]:
        state = self.initial_state(len(x)) if state is None else state
        if not torch.is_grad_enabled():
            return self.superposed((x, *aux), state)
        before = state.split(2, 1)
        a, b, c, d = self.matrices()
        direct, after, y = self.direct(), list(before), torch.zeros_like(x)
        for k, u in enumerate((x, *aux)):
            driven = direct[k] * u
            for m in range(len(a)):
                place = k * len(a) + m
                part, after[place] = state_space(u, a[m], b[m], c[k, m], d[k, m], before[place])
                driven = driven + part
            y = y + driven
        return y, torch.cat(after, 1)

    def superposed(self, inputs: Sequence[Tensor], state: Tensor) -> tuple[Tensor, Tensor]:
        """`forward` without gradients: bit-identical, in a fraction of the time."""
        a, b, c, d = (part.contiguous().numpy() for part in self.matrices())
        rows, modes = len(inputs[0]), len(a)
        u = torch.cat([one.to("cpu", torch.float64) for one in inputs]).numpy()
        states = state.to("cpu", torch.float64).numpy()
        states = states.reshape(rows, len(self.share), modes, 2).swapaxes(0, 1).copy()
        after, y = states[: len(inputs)].reshape(len(u), modes, 2), np.empty_like(u)
        which = np.repeat(np.arange(len(inputs)), rows)
        residues = np.ascontiguousarray(c.transpose(1, 2, 0)), np.ascontiguousarray(d.T)
        superposed(u, a, b, *residues, self.direct().numpy(), which, after, y)
        states[: len(inputs)] = after.reshape(len(inputs), rows, modes, 2)
        total = torch.zeros(rows, u.shape[1], dtype=torch.float64)
        for driven in torch.from_numpy(y).split(rows):
            total = total + driven
        state_after = torch.from_numpy(states.swapaxes(0, 1).reshape(state.shape))
        return total.to(inputs[0].device, inputs[0].dtype), state_after.to(state.device, state.dtype)

    def direct(self) -> Tensor:
        """Return the gain past the modes, (inputs,), with which each input keeps its static gain."""
        one = torch.ones(1, dtype=torch.float64)
        return torch.cat([one, self.coupling_um_per_v]) - self.share.sum(1)

    def matrices(self) -> Matrices:
        """Return A (modes, 2, 2), B (modes, 2), C (inputs, modes, 2), D (inputs, modes), discrete."""
        a, b, feedthrough = self.states(self.frequency_hz, self.damping_ratio)
        c = torch.stack([self.share, self.rate_share], -1)
        return a, b, c, (c * feedthrough).sum(-1)

    def states(self, frequency_hz: Tensor, damping_ratio: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Return A (modes, 2, 2), B (modes, 2), and the feedthrough of the input to each state, (modes, 2).

        The states are M(u) and Ṁ(u)/ω₀.
        """
        omega = 2 * math.pi * frequency_hz
        zero = torch.zeros_like(omega)
        a = torch.stack([zero, omega, -omega, -2 * damping_ratio * omega], -1).reshape(-1, 2, 2)
        b = torch.stack([zero, omega], -1)
        both = torch.eye(2, dtype=torch.float64)[:, None].expand(2, len(omega), 2)
        # With one output for each state, D is the feedthrough that the hold adds to that state.
        twice = (a.expand(2, -1, 2, 2), b.expand(2, -1, 2), both, zero.expand(2, -1))
        a_d, b_d, _, d = discretise(*twice, self.sample_period_s, self.hold)
        return a_d[0], b_d[0], d.T

    @torch.no_grad()
    def slopes(
        self,
        x: Tensor,  # (1, time), µm
        aux: Sequence[Tensor],  # (1, time) each, V
    ) -> dict[tuple[int, str], Tensor]:  # (1, time) each
        """Return the derivative of the output by each parameter of each part, from the de-energised state."""
        inputs = torch.cat([x, *aux])
        now = self.responses(inputs, self.frequency_hz, self.damping_ratio)
        step = 1 + RELATIVE_STEP
        c = torch.stack([self.share, self.rate_share], -1)
        found: dict[str, Tensor] = {
            "share": now[..., 0, :] - inputs[:, None],
            "rate_share": now[..., 1, :],
            "coupling_um_per_v": inputs[1:],
        }
        for name, moved in (
            ("frequency_hz", (self.frequency_hz * step, self.damping_ratio)),
            ("damping_ratio", (self.frequency_hz, self.damping_ratio * step)),
        ):
            change = self.responses(inputs, *moved) - now
            size = (RELATIVE_STEP * self.get_parameter(name))[:, None]
            found[name] = torch.einsum("kms,kmst->mt", c, change) / size
        return {(part, name): found[tensor][at][None] for part, name, tensor, at in self.places}

    @torch.no_grad()
    def responses(self, inputs: Tensor, frequency_hz: Tensor, damping_ratio: Tensor) -> Tensor:
        """Return both states of each mode for each input, (inputs, modes, 2, time)."""
        a, b, d = (part.contiguous().numpy() for part in self.states(frequency_hz, damping_ratio))
        out = np.empty((len(inputs), len(a), 2, inputs.shape[1]))
        mode_states(inputs.contiguous().numpy(), a, b, d, out)
        return torch.from_numpy(out)

    def stream(self) -> nn.Module:
        a, b, c, d = self.matrices()
        own = [
            LinearStream(a[m].flatten().tolist(), b[m].tolist(), c[0, m].tolist(), d[0, m].item())
            for m in range(len(a))
        ]
        return ModesStream(self.direct()[0].item(), own)


class ModesStream(nn.Module):
    """The modes, one sample at a time; the other axes are at rest."""

    def __init__(self, direct: float, modes: list[LinearStream]) -> None:
        super().__init__()
        self.direct = direct
        self.modes: Any = nn.ModuleList(modes)

    @torch.jit.export
    def reset(self) -> None:
        for mode in self.modes:
            mode.reset()

    @torch.jit.export
    def step(self, x: float) -> float:
        y = self.direct * x
        for mode in self.modes:
            y = y + mode.step(x)
        return y


def places(parts: Sequence[Part]) -> list[Place]:
    """Return the place of each parameter of each part, except a coupling's parameters for absent modes."""
    found: list[Place] = []
    numbers = mode_numbers([part.effect for part in parts])
    modes = [k for k, part in enumerate(parts) if issubclass(part.effect, ModalResonance)]
    for m, k in enumerate(modes):
        found += [Place(k, name, name, (m,)) for name in ("frequency_hz", "damping_ratio")]
        found += [Place(k, name, name, (0, m)) for name in ("share", "rate_share")]
    coupled = 0
    for k, part in enumerate(parts):
        if part.effect is not ModalCoupling:
            continue
        found.append(Place(k, "coupling_um_per_v", "coupling_um_per_v", (coupled,)))
        coupled += 1
        for m, number in enumerate(numbers):
            found.append(Place(k, f"mode{number}_um_per_v", "share", (coupled, m)))
            found.append(Place(k, f"mode{number}_rate_um_per_v", "rate_share", (coupled, m)))
    return found
