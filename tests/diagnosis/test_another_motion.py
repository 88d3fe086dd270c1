"""The uncertainty of another motion, against a direct solution and against the error that is really made."""

from dataclasses import replace

import numpy as np
import pytest

from tests.diagnosis.plants import NOISE_UM, multisine, triangles
from tests.diagnosis.prepared import prepared
from tests.diagnosis.test_across_recordings import SAMPLES, STEPS, fitted, recorded
from torchpi.diagnosis.another_motion import another_motion_um, random_reversals
from torchpi.diagnosis.chain import Chain
from torchpi.diagnosis.diagnose import diagnose
from torchpi.diagnosis.fit import REMANENCE, weight_prior
from torchpi.diagnosis.hypothesis import Hypothesis
from torchpi.diagnosis.hysteresis_model import plain, preisach
from torchpi.diagnosis.outside import Outside
from torchpi.diagnosis.records import seen

LOOPS = multisine(SAMPLES, high_hz=40.0)


def uncertainty_um(*voltages: np.ndarray, remanent: bool = False) -> float:
    """The uncertainty that these voltages leave to a Preisach operator, fitted to the noise."""
    chain = Chain(prepared(recorded(*voltages)))
    final = fitted(chain, Hypothesis(preisach(seen(chain.records)), remanent=remanent))
    return another_motion_um(chain, final.hypothesis)


def test_minor_loops_determine_other_motions_and_steps_do_not() -> None:
    assert uncertainty_um(LOOPS, multisine(SAMPLES, high_hz=40.0, seed=2)) < NOISE_UM
    assert uncertainty_um(STEPS) > 5 * NOISE_UM


def test_another_recording_lowers_the_uncertainty() -> None:
    assert uncertainty_um(STEPS, LOOPS) < uncertainty_um(STEPS)


def test_an_unknown_history_raises_the_uncertainty() -> None:
    assert uncertainty_um(triangles(SAMPLES), remanent=True) > 1.5 * uncertainty_um(triangles(SAMPLES))


@pytest.mark.parametrize("recording", [STEPS, triangles(SAMPLES)])
def test_the_error_of_another_motion_is_of_the_stated_size(recording: np.ndarray) -> None:
    motion = random_reversals(0.0, 10.0)
    truth = recorded(motion)[0].y
    chain = Chain(prepared(recorded(recording)))
    final = fitted(chain, Hypothesis(preisach(seen(chain.records))))
    nominal = final.hypothesis.nominal
    y = nominal.output(motion, chain.records[0].period_s, final.weights[: nominal.kept])
    error = float(np.std(truth - y))
    stated = float(np.hypot(another_motion_um(chain, final.hypothesis), NOISE_UM))
    assert 0.3 * stated < error < 3 * stated


def test_plays_that_two_levels_leave_undetermined_do_not_carry_over() -> None:
    found = diagnose(recorded(STEPS, bend=0.0))
    assert found.verdict == "nothing_missing" and not found.carries_over
    assert found.another_motion_um is not None and found.another_motion_um > 5 * NOISE_UM


def test_a_simulation_that_the_hysteresis_corrects_counts_as_known() -> None:
    chain = Chain(prepared(recorded(LOOPS)))
    alone = Hypothesis(plain(seen(chain.records)))
    beside = Hypothesis(replace(alone.nominal, simulation=Outside(None)))
    assert another_motion_um(chain, beside) == another_motion_um(chain, alone) > 0


def test_it_is_the_standard_deviation_of_a_direct_solution() -> None:
    """All unknowns in one least-squares problem, the zeros and histories among them, and its covariance."""
    chain = Chain(prepared(recorded(LOOPS, triangles(SAMPLES))))
    hypothesis = replace(fitted(chain, Hypothesis(plain(seen(chain.records)))).hypothesis, remanent=True)
    nominal, count = hypothesis.nominal, len(chain.records)
    own = 1 + nominal.remembers
    unknowns = nominal.kept + count * own
    blocks = [np.zeros((unknowns, unknowns))]
    blocks[0][: nominal.kept, : nominal.kept] = np.eye(nominal.kept) * np.sqrt(weight_prior(chain))
    for i in range(count):
        for k in range(nominal.remembers):
            place = nominal.kept + i * own + 1 + k
            blocks[0][place, place] = 1 / (REMANENCE * chain.span_um)
        u = chain.records[i].u
        rows = np.empty((nominal.kept, len(u)))
        nominal.fill(u, chain.records[i].period_s, rows)
        of_it = np.concatenate([np.ones((1, len(u))), nominal.remembered(u)])
        whitened = chain.whitened(i, np.concatenate([rows, of_it]))
        block = np.zeros((whitened.shape[1], unknowns))
        block[:, : nominal.kept] = whitened[: nominal.kept].T
        block[:, nominal.kept + i * own : nominal.kept + (i + 1) * own] = whitened[nominal.kept :].T
        blocks.append(block)
    triangle = np.linalg.qr(np.concatenate(blocks), mode="r")
    span = [record.u for record in chain.records]
    motion = random_reversals(min(map(np.min, span)), max(map(np.max, span)))
    x = np.zeros((unknowns, len(motion)))
    nominal.fill(motion, chain.records[0].period_s, x[: nominal.kept])
    x -= x.mean(1, keepdims=True)
    expected = np.sqrt((np.linalg.solve(triangle.T, x) ** 2).sum(0).mean())
    assert another_motion_um(chain, hypothesis) == pytest.approx(expected, rel=1e-4)
