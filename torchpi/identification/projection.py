"""The weights that are best for given nonlinear parameters: variable projection (Golub and Pereyra, 1973).

The voltage is linear in θ and the offset, so for every trial of the other parameters they are solved for
instead of searched. At that solution the loss is flat in θ, so the gradient of the loss with θ held is
the gradient of the projected loss.
"""

from collections.abc import Sequence

import torch
from torch import Tensor

from torchpi.compensator import DirectInverse
from torchpi.motion import Motion
from torchpi.operators.weighted_sum import weighted_sum

# Neighbouring plays are nearly collinear. This share of the columns' mean square keeps single weights
# from growing without bound in directions that change the voltage by less than the noise: a hundredth
# of it leaves inverses that run backwards just after a reversal, a hundred times it costs accuracy.
RIDGE = 1e-8


def projected_loss(
    compensator: DirectInverse,
    motions: Sequence[Motion],  # of each record, (1, time)
    voltages: Sequence[Tensor],  # of each record, (1, time), V
    counted: Sequence[slice],  # samples of each that count
) -> Tensor:
    """Mean squared error, V², at the weights that are best for the other parameters, which are set."""
    h, basis, wanted = [], [], []
    for motion, u, part in zip(motions, voltages, counted, strict=True):
        states, _ = compensator.play_states(motion)
        h.append(states[:, part])
        basis.append(compensator.weights.basis(motion.yd_dot[:, part]))
        wanted.append(u[:, part])
    solve_weights(compensator, [a[0] for a in h], [b[0] for b in basis], [u[0] for u in wanted])
    theta, offset = compensator.weights.theta.detach(), compensator.offset.detach()
    errors = [weighted_sum(a, b, theta) + offset - u for a, b, u in zip(h, basis, wanted, strict=True)]
    return torch.cat(errors, 1).square().mean()


def solve_weights(
    compensator: DirectInverse,
    h: Sequence[Tensor],  # of each record, (samples, plays)
    basis: Sequence[Tensor],  # of each record, (samples, functions)
    u: Sequence[Tensor],  # of each record, (samples,), V
) -> None:
    """Set θ, and the offset where there is one, to their least-squares values."""
    theta = compensator.weights.theta
    with torch.no_grad():
        with_offset = compensator.offset.requires_grad
        columns = torch.cat([_columns(a, b, with_offset) for a, b in zip(h, basis, strict=True)])
        size = columns.square().mean(0).sqrt()
        size[size == 0] = 1.0  # a play that nothing moved
        columns /= size
        gram = columns.T @ columns / len(columns)
        gram.diagonal().add_(RIDGE)
        wanted = columns.T @ torch.cat(list(u)) / len(columns)
        solution = torch.linalg.solve(gram, wanted) / size
        theta.copy_(solution[: theta.numel()].reshape(theta.shape))
        if with_offset:
            compensator.offset.copy_(solution[-1])


def _columns(h: Tensor, basis: Tensor, offset: bool) -> Tensor:
    """Everything that θ and the offset multiply. Shape: (samples, columns)."""
    columns = (h[:, :, None] * basis[:, None, :]).flatten(1)
    return torch.cat([columns, torch.ones_like(columns[:, :1])], 1) if offset else columns
