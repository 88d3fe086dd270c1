"""An external simulation in place of the hysteresis, with corrections.

    y = g F(v) + Σ_i F_i(x_i) + …

F is the simulation, called with the voltage v or given as recorded output. g corrects its gain, the sum its
static hysteresis; both act outside the simulation, because nothing inside it is known.
"""

from collections.abc import Mapping
from typing import Any

import torch
from torch import Tensor, nn

from torchpi.errors import StageError
from torchpi.simulators import COLUMN, Simulator
from torchpi.stage.hysteresis import Hysteresis


class SimulatedHysteresis(Hysteresis):
    """A `Hysteresis` beside a simulation that is called with whole records, or whose output is recorded.

    Its last state counts the records that were started, because a call starts from rest and cannot continue.

    Args:
        sample_period_s: T.
        simulation: `reference`, the name of the simulation, or "column" if its output is recorded;
            `gain`, g.
        hysteresis: Arguments of `Hysteresis`.
    """

    gain: nn.Parameter

    def __init__(self, sample_period_s: float, simulation: Mapping[str, Any], **hysteresis: Any) -> None:
        super().__init__(sample_period_s, **hysteresis)
        self.reference = str(simulation["reference"])
        self.gain = nn.Parameter(torch.tensor(float(simulation["gain"]), dtype=torch.float64))
        self.simulator: Simulator | None = None

    def settings(self) -> dict[str, Any]:
        gain = self.gain.item()
        return {**super().settings(), "simulation": {"reference": self.reference, "gain": gain}}

    def initial_state(self, batch: int) -> Tensor:
        return torch.cat([super().initial_state(batch), torch.zeros(batch, 1, dtype=torch.float64)], 1)

    def forward(
        self,
        x: Tensor,  # (batch, time), V
        state: Tensor | None = None,  # (batch, states)
        simulated: Tensor | None = None,  # (batch, time), µm, where the output is recorded
    ) -> tuple[Tensor, Tensor]:
        state = self.initial_state(len(x)) if state is None else state
        corrected, after = super().forward(x, state[:, :-1])
        y = self.called(x, state[:, -1]) if simulated is None else simulated
        return corrected + self.gain * y, torch.cat([after, state[:, -1:] + 1], 1)

    def called(self, x: Tensor, begun: Tensor) -> Tensor:
        """Return F(v), (batch, time), µm.

        Raises:
            StageError: There is no simulation to call, or it would have to be continued or differentiated.
        """
        what = f"simulation '{self.reference}'"
        if self.simulator is None:
            raise StageError(f"{what}: found only its name, expected --simulation {self.reference}")
        if bool(begun.any()):
            raise StageError(f"{what}: found a state to continue from, expected a whole record from rest")
        if x.requires_grad and torch.is_grad_enabled():
            raise StageError(
                f"{what}: found a gradient through it, expected a stage that calls no simulation"
            )
        fs_hz = 1.0 / self.sample_period_s
        rows = [torch.tensor(self.simulator(row, fs_hz)) for row in x.detach().to(torch.float64).numpy()]
        return torch.stack(rows).to(x)

    def stream(self) -> nn.Module:  # type: ignore[override]
        kind = "a recorded output" if self.reference == COLUMN else "whole records"
        raise StageError(
            f"simulation '{self.reference}': found {kind}, expected a stage that steps sample by sample"
        )
