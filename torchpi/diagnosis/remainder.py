"""The unknown path: what every named effect leaves, by ridge regression, judged on held-out samples."""

from dataclasses import replace

import numpy as np
import torch

from torchpi.diagnosis.chain import Chain
from torchpi.diagnosis.fit import rms
from torchpi.diagnosis.hypothesis import Fit, Member
from torchpi.diagnosis.records import seen
from torchpi.stage.effects.unknown import TIMES, Unknown

RIDGES = (1e-2, 1e-3, 1e-4, 1e-5)
MIDDLE_RIDGE = 1e-3
LEAST_GAIN = 0.01
LARGEST = Unknown.quantities["a0"].at_most


def with_remainder(chain: Chain, now: Fit, judged: bool = True) -> Fit | None:
    """The fit with the unknown remainder at the end of its chain; None if that does not help held-out data.

    Not `judged`, where nothing is held out, it takes the middle ridge.

    The remainder is fitted to the residual off the tangent of the weights: what retuning could do is not
    its.
    """
    records, what = chain.records, seen(chain.records)
    frame = {
        "length_um": max(what.span_um, 1e-9),
        "shortest_s": 2 / what.fs_hz,
        "longest_s": max(what.duration_s, 4 / what.fs_hz),
    }
    frame = {
        n: min(max(v, Unknown.quantities[n].at_least), Unknown.quantities[n].at_most)
        for n, v in frame.items()
    }
    columns, tangents = [], []
    for i, (record, residual) in enumerate(zip(records, now.residuals, strict=True)):
        y, directions = chain.output_and_directions(now.hypothesis, now.weights, i)
        module = Unknown(record.period_s, **frame)
        columns.append(module.columns(torch.from_numpy(y)[None]).detach().numpy())
        tangents.append(directions)
        assert len(residual) == columns[-1].shape[1]
    fitted = [(c[:, r.fitted], t[:, r.fitted], e[r.fitted]) for c, t, r, e in
              zip(columns, tangents, records, now.residuals, strict=True)]  # fmt: skip
    inner = sum(t @ t.T for _, t, _ in fitted)
    inner = inner + 1e-9 * np.diag(np.diag(inner))
    across = sum(t @ c.T for c, t, _ in fitted)
    removed = np.linalg.solve(inner, across)
    gram = sum(c @ c.T for c, _, _ in fitted) - across.T @ removed
    right = sum(c @ e for c, _, e in fitted) - removed.T @ sum(t @ e for _, t, e in fitted)
    size = np.sqrt(np.maximum(np.diag(gram), 1e-300))
    best: Fit | None = None
    for ridge in RIDGES if judged else (MIDDLE_RIDGE,):
        unit = gram / size / size[:, None] + ridge * np.eye(len(size))
        a = np.linalg.solve(unit, right / size) / size
        if np.abs(a).max() > LARGEST:
            continue
        weights = now.weights - removed @ a
        member = Member(
            Unknown, frame | {f"{'ab'[k // TIMES]}{k % TIMES}": float(v) for k, v in enumerate(a)}
        )
        hypothesis = replace(now.hypothesis, members=(*now.hypothesis.members, member))
        residuals = tuple(record.y - chain.output(hypothesis, weights, i) for i, record in enumerate(records))
        one = replace(
            now, hypothesis=hypothesis, weights=weights, residuals=residuals,
            train_rms=rms(records, residuals, True),
            heldout_rms=rms(records, residuals, False) if judged else 0.0,
        )  # fmt: skip
        if best is None or one.heldout_rms < best.heldout_rms:
            best = one
    if best is None or (judged and best.heldout_rms >= (1 - LEAST_GAIN) * now.heldout_rms):
        return None
    return best
