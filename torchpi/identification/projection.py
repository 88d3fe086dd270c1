"""Solve for the best weights at given nonlinear parameters: variable projection (Golub and Pereyra, 1973).

The voltage is linear in θ, ψ and the offset, so they are solved for at every trial of the other parameters
instead of being searched. At that solution the loss is stationary in them, so its gradient with them held
fixed is the gradient of the projected loss.
"""

from collections.abc import Sequence

import torch
from torch import Tensor, nn

from torchpi.control.direct_inverse import DirectInverse
from torchpi.operators.motion import Motion
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
    """Set the weights that are best for the other parameters, and return the mean squared error, V²."""
    h, basis, target = [], [], []
    for motion, u, part in zip(motions, voltages, counted, strict=True):
        states, _ = compensator.play_states(motion)
        h.append(states[:, part])
        basis.append(compensator.weights.basis(motion.yd_dot[:, part]))
        target.append(u[:, part])
    solve_weights(compensator, [a[0] for a in h], [b[0] for b in basis], [u[0] for u in target])
    solved = [part.detach() for part in (compensator.weights.theta, compensator.psi, compensator.offset)]
    theta, psi, offset = solved
    errors = [
        weighted_sum(a, b, theta, psi, compensator.range_um) + offset - u
        for a, b, u in zip(h, basis, target, strict=True)
    ]
    return torch.cat(errors, 1).square().mean()


def solve_weights(
    compensator: DirectInverse,
    h: Sequence[Tensor],  # of each record, (samples, plays)
    basis: Sequence[Tensor],  # of each record, (samples, functions)
    u: Sequence[Tensor],  # of each record, (samples,), V
) -> None:
    """Set θ, ψ, and the offset where there is one, to their least-squares values."""
    with torch.no_grad():
        columns = linear_columns(compensator, h, basis, compensator.psi.shape[1])
        size = columns.square().mean(0).sqrt()
        size[size == 0] = 1.0  # a play that never moved
        columns /= size
        gram = columns.T @ columns / len(columns)
        gram.diagonal().add_(RIDGE)
        target = columns.T @ torch.cat(list(u)) / len(columns)
        solution = torch.linalg.solve(gram, target) / size
        start = 0
        for part in linear_parameters(compensator):
            part.copy_(solution[start : start + part.numel()].reshape(part.shape))
            start += part.numel()


def linear_parameters(compensator: DirectInverse) -> list[nn.Parameter]:
    """Return the parameters that the voltage is linear in, in the order of the columns."""
    offset = [compensator.offset] if compensator.offset.requires_grad else []
    return [compensator.weights.theta, compensator.psi, *offset]


def linear_columns(
    compensator: DirectInverse,
    h: Sequence[Tensor],  # of each record, (samples, plays)
    basis: Sequence[Tensor],  # of each record, (samples, functions)
    own_degree: int,  # degree of the plays' own output functions beyond the weighted sum
) -> Tensor:  # (samples of all, columns)
    """Return the columns that those parameters multiply: φ_m h_i, z_i^q h_i, and 1 for the offset."""
    plays, functions = h[0].shape[1], basis[0].shape[1]
    parts = [plays * functions, plays * own_degree, int(compensator.offset.requires_grad)]
    columns = h[0].new_empty(sum(len(a) for a in h), sum(parts))
    for rows, a, b in zip(columns.split([len(a) for a in h]), h, basis, strict=True):
        of_rate, own, offset = rows.split(parts, 1)
        # The columns are written in place: they take tens of megabytes, and a copy costs as much as they do.
        of_rate.unflatten(1, (plays, functions)).copy_(a[:, :, None] * b[:, None, :])
        for q in range(own_degree):
            own[:, q::own_degree] = (a / compensator.range_um) ** (q + 1) * a
        offset.fill_(1.0)
    return columns
