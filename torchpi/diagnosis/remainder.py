"""The unknown remainder: ridge regression, on a general fading memory, of what all named effects leave."""

from dataclasses import replace

import numpy as np
import torch

from torchpi.diagnosis.chain import Chain
from torchpi.diagnosis.contest import STEPS
from torchpi.diagnosis.exchange import rms_of
from torchpi.diagnosis.fit import ROUGH, left_out, rms
from torchpi.diagnosis.hypothesis import EffectTerm, Fit
from torchpi.diagnosis.normal_equations import solve, to_unit_diagonal
from torchpi.diagnosis.posterior import Believed
from torchpi.diagnosis.records import seen
from torchpi.diagnosis.reduced_basis import reduced
from torchpi.diagnosis.rival_models import OPERATOR_NAME
from torchpi.diagnosis.score import gain
from torchpi.diagnosis.search import Search
from torchpi.diagnosis.sensitivity import Sensitivity, jacobian
from torchpi.stage.effects.unknown import TIMES, Unknown

RIDGES = (1e-1, 1e-2, 1e-3, 1e-4)
EARNS = 0.95
"""Minimum probability that the recordings are predicted better with the remainder than without it."""
REPLACES = 0.5
"""Probability from which the unknown remainder, which is on no list, replaces a larger hysteresis."""
FAINT = 0.3
"""Minimum share of the rms that is left which the remainder has to remove."""
LARGEST = Unknown.quantities["a0"].at_most


def with_remainder(chain: Chain, now: Fit, ridge: float | None = None) -> tuple[Fit, float] | None:
    """Return the fit with the unknown remainder at the end of its chain, and its ridge.

    None if it predicts no better, or removes less than `FAINT` of the rms that is left. The remainder is
    fitted off the tangent space of the weights, so that it takes nothing that retuning could explain. If a
    `ridge` is given, nothing is chosen or judged.
    """
    records, what = chain.records, seen(chain.records)
    frame = {
        "length_um": max(what.span_um, 1e-9),
        "shortest_s": 2 / what.fs_hz,
        "longest_s": max(what.duration_s, 4 / what.fs_hz),
    }
    frame = {name: Unknown.quantities[name].nearest(value) for name, value in frame.items()}
    columns, tangents, errors = [], [], []
    for i, (record, residual) in enumerate(zip(records, now.residuals, strict=True)):
        y, (places, rows) = jacobian(chain, now.hypothesis, now.weights, (), np.zeros(0), i)
        tangent = np.zeros((len(now.weights), rows.shape[1]))
        tangent[places] = rows
        module = Unknown(record.period_s, **frame)
        columns.append(chain.whitened(i, module.columns(torch.from_numpy(y)[None]).detach().numpy()))
        tangents.append(tangent)
        errors.append(chain.whitened(i, residual[None])[0])
    with np.errstate(over="ignore", invalid="ignore"):
        squares = np.sum([c @ c.T for c in columns], 0)
    if not np.isfinite(squares).all():  # the readings do not move: nothing is left to explain
        return None
    inner = np.sum([t @ t.T for t in tangents], 0)
    unit, scale = to_unit_diagonal(inner)
    across = np.sum([t @ c.T for t, c in zip(tangents, columns, strict=True)], 0)
    removed = scale[:, None] * np.linalg.solve(unit, scale[:, None] * across)
    gram = squares - across.T @ removed
    right = np.sum([c @ e for c, e in zip(columns, errors, strict=True)], 0)
    right -= removed.T @ np.sum([t @ e for t, e in zip(tangents, errors, strict=True)], 0)
    every = np.arange(len(inner) + len(right))
    parts = [Sensitivity(every, np.concatenate([t, c])) for t, c in zip(tangents, columns, strict=True)]
    best: tuple[Fit, float] | None = None
    density = chain.weighting.log_density
    for one_ridge in RIDGES if ridge is None else (ridge,):
        a = solve(gram, right, ridge=one_ridge)
        if np.abs(a).max() > LARGEST:
            continue
        weights = now.weights - removed @ a
        member = EffectTerm(
            Unknown, frame | {f"{'ab'[k // TIMES]}{k % TIMES}": float(v) for k, v in enumerate(a)}
        )
        hypothesis = replace(now.hypothesis, members=(*now.hypothesis.members, member))
        residuals = tuple(record.y - chain.output(hypothesis, weights, i) for i, record in enumerate(records))
        prior = np.diag(np.concatenate([np.zeros(len(inner)), one_ridge * np.diag(gram)]))
        one = replace(
            now,
            hypothesis=hypothesis,
            weights=weights,
            residuals=residuals,
            train_rms=rms(records, residuals, True),
            heldout_rms=rms(records, residuals, False),
            left_out_um2=left_out(chain, residuals, parts, prior),
        )
        if best is None or density(one).sum() > density(best[0]).sum():
            best = one, one_ridge
    if best is None:
        return None
    removed_um2 = now.train_rms**2 - best[0].train_rms ** 2
    faint = removed_um2 < (FAINT * now.train_rms) ** 2
    gained = gain(density(best[0]), density(now), strata=chain.weighting.strata)
    if ridge is None and (faint or gained.probability < EARNS):
        return None
    return best


def unless_unknown(
    search: Search, retuned: Fit, final: Fit, believed: list[Believed]
) -> tuple[Fit, list[Believed]]:
    """Return the best hypothesis and its effects after trying the unknown remainder in place of a larger
    hysteresis, whose hundreds of parameters fit anything: without it if the remainder predicts better."""
    h, before = final.hypothesis, retuned.hypothesis.nominal
    if search.jump or h.nominal.family == before.family:
        return final, believed
    chain = search.chain
    (plain,) = search.fits([(h.on(before), None, STEPS, ROUGH)])
    beside, instead = (with_remainder(chain, reduced(chain, one)) for one in (final, plain))
    if instead is None:
        return final, believed
    lost = search.over(instead[0], beside[0] if beside else final).probability
    if lost > REPLACES:
        search.log(f"  an unknown remainder in place of a larger hysteresis: {rms_of(instead[0])}")
        return plain, [one for one in believed if one.name != OPERATOR_NAME]
    return final, [
        replace(one, probability=round(one.probability * (1 - lost), 4)) if one.name == OPERATOR_NAME else one
        for one in believed
    ]
