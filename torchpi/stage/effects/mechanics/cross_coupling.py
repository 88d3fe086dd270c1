"""Motion that another axis causes in this one: y = x + c a, where a is an auxiliary signal of the recording.

Devasia, Eleftheriou and Moheimani, *A survey of control issues in nanopositioning*, IEEE Trans. Control
Systems Technology 15(5), 2007.
"""

from torch import Tensor, nn

from torchpi.operators.chain import ChainStream
from torchpi.stage.effects.effect import DataRange, Effect, Parameters, parameter


class CrossCoupling(Effect):
    """The one effect with a second input; without it, nothing is added."""

    name = "cross_coupling"
    block = "mechanics"
    equation = "y = x + c a"
    signature = "coherent with the other axis, whatever this one does"
    coupling_um_per_v: nn.Parameter = parameter("µm/V", at_least=-1e3, at_most=1e3)
    takes_aux = True

    def forward(
        self,
        x: Tensor,  # (batch, time), µm
        state: Tensor | None = None,  # (batch, 0)
        aux: Tensor | None = None,  # (batch, time), V
    ) -> tuple[Tensor, Tensor]:
        y = x if aux is None else x + self.coupling_um_per_v * aux
        return y, self.initial_state(len(x)) if state is None else state

    def stream(self) -> nn.Module:
        return ChainStream([])  # a rig that is stepped has the other axis at rest

    def tangent(self, x: Tensor, dx: Tensor) -> Tensor:
        return dx.detach()

    @classmethod
    def starts(cls, seen: DataRange) -> list[Parameters]:
        # The output is linear in c, so one step of a fit converges from any start.
        strongest = max(seen.aux.values(), default=0.0)
        if strongest == 0 or seen.span_um == 0:
            return []
        return [{"coupling_um_per_v": 0.01 * seen.span_um / strongest}]
