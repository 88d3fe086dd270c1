"""A series of operators; an empty series is the identity."""

from typing import Any

import torch
from torch import Tensor, nn

from torchpi.operators.base import Operator


class Chain(Operator):
    """A series of operators with one state, theirs side by side.

    Args:
        operators: First to last, each from (batch, time) to (batch, time), under the name of its
            submodule; None leaves its place empty.

    Example:
        >>> import torch
        >>> from torchpi import Polynomial, PrandtlIshlinskii
        >>> from torchpi.operators import Chain
        >>> loop = PrandtlIshlinskii([0.0, 0.5], [0.75, 0.25])
        >>> drive = Chain(hysteresis=loop, saturation=Polynomial([1.0, -0.5]))
        >>> drive(torch.tensor([[0.0, 1.0, 0.0]], dtype=torch.float64))[0].tolist()
        [[0.0, 0.4921875, 0.1171875]]
    """

    def __init__(self, **operators: Operator | None) -> None:
        super().__init__()
        for name, operator in operators.items():
            self.add_module(name, operator)
        self.order = [name for name, operator in operators.items() if operator is not None]

    def series(self) -> list[Operator]:
        """Return the operators that are present, first to last."""
        return [self.get_submodule(name) for name in self.order]  # type: ignore[misc]

    def initial_state(self, batch: int) -> Tensor:
        parts = [operator.initial_state(batch).cpu() for operator in self.series()]
        return torch.cat([super().initial_state(batch), *parts], 1)

    def forward(self, x: Tensor, state: Tensor | None = None) -> tuple[Tensor, Tensor]:
        state = self.initial_state(len(x)).to(x.device) if state is None else state
        series = self.series()
        sizes = [operator.initial_state(1).shape[1] for operator in series]
        after = [state[:, :0]]
        for operator, part in zip(series, state.split(sizes, 1), strict=False):
            x, part = operator(x, part)
            after.append(part)
        return x, torch.cat(after, 1)

    def stream(self) -> "ChainStream":
        return ChainStream([operator.stream() for operator in self.series()])


class ChainStream(nn.Module):
    """The series, one sample at a time."""

    def __init__(self, streams: list[nn.Module]) -> None:
        super().__init__()
        self.streams: Any = nn.ModuleList(streams)

    @torch.jit.export
    def reset(self) -> None:
        for stream in self.streams:
            stream.reset()

    @torch.jit.export
    def step(self, x: float) -> float:
        for stream in self.streams:
            x = stream.step(x)
        return x
