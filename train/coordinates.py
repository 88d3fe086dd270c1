"""Coordinates in which every direction changes the voltage by the same amount.

Neighbouring plays are nearly collinear: the effects of directions in the compensator's own parameters differ
by a factor of 10⁵, and a descent converges slowly. The stage is nearly a gain, so coordinates that whiten the
voltage also whiten the motion, and a quasi-Newton step in them is nearly a Gauss–Newton step.
"""

import torch
from torch import Tensor
from torch.func import functional_call

from torchpi.control.direct_inverse import DirectInverse
from torchpi.operators.motion import Motion

RIDGE = 1e-6
"""Regularisation: keeps steps small along directions whose share of a parameter's effect is below this."""
STEP = 1e-6
"""Relative step of a forward difference; parameters are of order one."""


class Coordinates:
    """θ = θ_0 + M z over all trained parameters of a compensator; θ_0 are its current parameters.

    Args:
        compensator: The compensator; it is not modified.
        motion: Motion for which the voltage is computed, (batch, time).
        unit_v: RMS change of that voltage for a step of length one.
    """

    def __init__(self, compensator: DirectInverse, motion: Motion, unit_v: float) -> None:
        self.compensator = compensator
        trained = {
            name: parameter.detach().clone()
            for name, parameter in compensator.named_parameters()
            if parameter.requires_grad and parameter.numel() > 0
        }
        self.shapes = {name: value.shape for name, value in trained.items()}
        self.origin = torch.cat([value.flatten() for value in trained.values()])
        moved = self._voltage_changes(motion)
        size = moved.square().mean(1).sqrt()
        size[size == 0] = 1.0  # parameter without effect, such as a play that never moves
        moved = moved / size[:, None]
        gram = moved @ moved.T / moved.shape[1]
        gram.diagonal().add_(RIDGE)
        self.reduction = unit_v * torch.linalg.inv(torch.linalg.cholesky(gram)).T / size[:, None]

    def __len__(self) -> int:
        return len(self.origin)

    def parameters(
        self,
        z: Tensor,  # (parameters,)
    ) -> dict[str, Tensor]:
        """Return the parameters of the compensator at `z`, differentiable in `z`."""
        return self._named(self.origin + self.reduction @ z)

    def put(self, z: Tensor) -> None:
        """Set the parameters of the compensator to those at `z`."""
        with torch.no_grad():
            for name, value in self.parameters(z).items():
                self.compensator.get_parameter(name).copy_(value)

    def _named(self, theta: Tensor) -> dict[str, Tensor]:
        parts = theta.split([shape.numel() for shape in self.shapes.values()])
        return {name: part.reshape(self.shapes[name]) for name, part in zip(self.shapes, parts, strict=True)}

    @torch.no_grad()
    def _voltage_changes(self, motion: Motion) -> Tensor:
        """Return the derivatives of the voltage by each parameter, (parameters, samples)."""
        at_origin = functional_call(self.compensator, self._named(self.origin), (motion,))
        rows = []
        for i, value in enumerate(self.origin.tolist()):
            step = STEP * max(abs(value), 1e-2)
            theta = self.origin.clone()
            theta[i] += step
            there = functional_call(self.compensator, self._named(theta), (motion,))
            rows.append((there - at_origin).flatten() / step)
        return torch.stack(rows)
