"""Data of the figures of a run."""

from collections.abc import Sequence

import numpy as np
import torch

from torchpi.control.direct_inverse import DirectInverse
from torchpi.identification import InversePair
from torchpi.report.training import RecordFit, Saturation, WeightsAgainstRate

from .module import InverseTraining
from .sensor_zero import fit_zeros

POINTS = 201


def record_fits(model: InverseTraining) -> tuple[RecordFit, ...]:
    """Return all records with their predicted voltages, the held-out ones first."""
    split, compensator = model.split, model.compensator
    zeros = fit_zeros(compensator, split.zero) or [0.0] * len(split.heldout)
    heldout = [
        _fit(compensator, pair, "held out", zero) for pair, zero in zip(split.heldout, zeros, strict=True)
    ]
    return (*heldout, *(_fit(compensator, pair, "trained on", 0.0) for pair in split.train))


def weights_against_rate(model: InverseTraining) -> WeightsAgainstRate | None:
    """Return w_i over the rates of the training records; None if the weights ignore the rate."""
    weights = model.compensator.weights
    if weights.kind == "none":
        return None
    low, high = _range(model.split.train, "yd_dot")
    rate = torch.linspace(low, high, POINTS, dtype=torch.float64)
    with torch.no_grad():
        w = weights(rate[None])[0]
    return WeightsAgainstRate(rate.numpy(), w.numpy(), model.compensator.plays.r.detach().numpy())


def saturation(model: InverseTraining) -> Saturation:
    """Return S over the displacements of the training records."""
    low, high = _range(model.split.train, "yd")
    y = torch.linspace(low, high, POINTS, dtype=torch.float64)
    with torch.no_grad():
        s, _ = model.compensator.saturation(y[None])
    return Saturation(y.numpy(), s[0].numpy(), model.compensator.saturation.c.detach().numpy())


def _fit(compensator: DirectInverse, pair: InversePair, role: str, zero_um: float) -> RecordFit:
    """Return the counted stretch of a record with its prediction."""
    counted = pair.counted
    with torch.no_grad():
        u_hat = compensator(pair.motion._replace(yd=pair.motion.yd - zero_um))
    t = pair.sample_period_s * np.arange(counted.start, counted.stop)
    y, u, predicted = (
        signal[0, counted].cpu().numpy() for signal in (pair.motion.yd - zero_um, pair.u, u_hat)
    )
    return RecordFit(pair.name, role, t, y, u, predicted)


def _range(pairs: Sequence[InversePair], signal: str) -> tuple[float, float]:
    values = torch.cat([getattr(pair.motion, signal)[0, pair.counted] for pair in pairs])
    return float(values.min()), float(values.max())
