"""How well the recordings determine a hysteresis for a motion that none of them contains.

A model with hundreds of weights may fit every recording down to the noise and still be wrong about the next
motion: the fit leaves out the combinations of weights that the recordings cannot distinguish, and another
motion may need them. Their prior and the readings give the standard deviation of its prediction (the
predictive variance of Bayesian linear regression: Bishop, *Pattern Recognition and Machine Learning*, 2006,
3.3.2). Unlike a prediction of one recording from the others, this also sees what all of them leave open.
"""

from dataclasses import replace
from math import sqrt

import numpy as np

from torchpi.diagnosis.chain import Chain
from torchpi.diagnosis.fit import REMANENCE, weight_prior
from torchpi.diagnosis.hypothesis import Hypothesis
from torchpi.diagnosis.normal_equations import eliminated, to_unit_diagonal
from torchpi.diagnosis.reduced_basis import in_blocks, rows_of, whitened_rows

REVERSALS, SAMPLES = 100, 100
"""Number of reversals of the motion that is predicted, and number of samples between two of them."""


def another_motion_um(chain: Chain, hypothesis: Hypothesis) -> float:
    """Return the rms standard deviation, µm, of the prediction of another motion by a hysteresis.

    The motion begins de-energised and reverses at random voltages in the range of the recordings, so that it
    has loops of all sizes. The parameters of the effects count as known, and so does a simulation that the
    hysteresis corrects.

    Args:
        chain: The recordings, with the weighting of the final fit.
        hypothesis: The hypothesis of that fit.
    """
    hysteresis = replace(hypothesis.nominal, simulation=None).unreduced
    bare = replace(hypothesis, nominal=hysteresis)
    voltages = [chain.voltage(bare, i) for i in range(len(chain.records))]
    prior = hysteresis.inverse_variances(weight_prior(chain), chain.gain_um_per_v)
    known = np.diag(prior)
    for i, v in enumerate(voltages):
        own = np.ones((1, len(v)))
        if bare.history:
            own = np.concatenate([own, hysteresis.remembered(v)])
        known += with_own_eliminated(whitened_rows(chain, bare, i), chain.whitened(i, own), chain.span_um)
    motion = random_reversals(min(0.0, *map(np.min, voltages)), max(0.0, *map(np.max, voltages)))
    at_rest = replace(bare, remanent=False)
    moved = np.concatenate(
        [
            rows_of(chain.nominal(replace(at_rest, nominal=some), 0), motion, chain.records[0].period_s)
            for some in in_blocks(hysteresis)
        ]
    )
    moved -= moved.mean(1, keepdims=True)  # a recording has its own zero
    unit, scale = to_unit_diagonal(known)
    variance = np.einsum("ij,ij->", np.linalg.inv(unit), (moved @ moved.T) * scale * scale[:, None])
    return sqrt(max(float(variance) / moved.shape[1], 0.0))


def with_own_eliminated(rows: np.ndarray, own: np.ndarray, span_um: float) -> np.ndarray:
    """Return the inner products of whitened rows, (rows, kept), after the zero and the history of their
    recording, the rows of `own`, have been eliminated: either may stand in for a hysteresis."""
    gram = own @ own.T
    history = np.arange(1, len(own))
    gram[history, history] += 1.0 / (REMANENCE * span_um) ** 2
    return eliminated(rows @ rows.T, rows @ own.T, gram)


def random_reversals(low_v: float, high_v: float) -> np.ndarray:
    """(time,), V: straight lines from 0 V between levels drawn evenly from a range."""
    levels = np.concatenate([[0.0], np.random.default_rng(0).uniform(low_v, high_v, REVERSALS)])
    v: np.ndarray = np.interp(np.arange(REVERSALS * SAMPLES) / SAMPLES, np.arange(len(levels)), levels)
    return v
