"""The least-squares problem behind every fit: its states, its exact derivative, its weights."""

from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from torchpi.control.direct_inverse import DirectInverse
from torchpi.identification import InversePair
from torchpi.identification.inverse_rows import SAMPLES, Record, blocks
from torchpi.identification.projected_problem import ProjectedProblem, nonlinear
from torchpi.identification.projection import linear_columns
from torchpi.identification.thin_qr import ThinQR
from torchpi.operators.motion import Motion

EVERYTHING = ["lead", "gains", "c", "r", "slope", "shift"]
PERIOD = 1e-3


def compensator(seed: int, **form: Any) -> DirectInverse:
    """Return a compensator with random parameters of typical size."""
    made = DirectInverse(
        PERIOD, [0.0, 0.3, 0.7, 1.5], range_um=4.0, rate_scale_um_s=3.0, train_thresholds=True, **form
    )
    generator = torch.Generator().manual_seed(seed)
    with torch.no_grad():
        for part in (made.scaled_lead, made.creep_gains, made.saturation.scaled):
            part += 0.2 * torch.randn(part.shape, generator=generator, dtype=torch.float64)
    return made


def pair(seed: int, samples: int, counted: slice) -> InversePair:
    generator = torch.Generator().manual_seed(seed)
    walks = (0.2 * torch.randn(4, samples, generator=generator, dtype=torch.float64)).cumsum(1)
    motion = Motion(walks[:1], walks[1:2], walks[2:3] / PERIOD)
    return InversePair(str(seed), motion, walks[3:], counted, PERIOD)


forms = st.fixed_dictionaries(
    {
        "degree": st.integers(1, 4),
        "rate": st.sampled_from(["none", "linear", "neural"]),
        "output_degree": st.integers(1, 3),
        "lead": st.integers(0, 2),
        "creep_time_constants_s": st.sampled_from([[], [0.02], [0.01, 0.1]]),
        "offset": st.booleans(),
    }
)


def problem(made: DirectInverse, pairs: list[InversePair], ridge: float) -> ProjectedProblem:
    return ProjectedProblem(
        made, pairs, EVERYTHING, made.weights.theta.shape[1], made.psi.shape[1], ridge=ridge
    )


@given(seed=st.integers(0, 99), form=forms)
def test_states_equal_those_of_the_compensator_bit_for_bit(seed: int, form: dict[str, Any]) -> None:
    made, record = compensator(seed, **form), pair(seed, 2 * SAMPLES + 300, slice(7, -20, 3))
    expected = made.play_states(record.motion)[0][0, record.counted].detach().numpy()
    for derivative in (False, True):
        found = blocks(Record.of(record).stretches(), nonlinear(made), made.creep_decay.numpy(), derivative)
        assert np.array_equal(np.concatenate([block.h.copy() for block in found]), expected)


@given(seed=st.integers(0, 99), form=forms, ridge=st.sampled_from([0.0, 1e-3]))
def test_the_linearisation_gives_the_gradient_of_the_projected_objective(
    seed: int, form: dict[str, Any], ridge: float
) -> None:
    made = compensator(seed, **form)
    records = [pair(seed, 400, slice(5, None)), pair(seed + 1, 700, slice(31, 600, 2))]
    of = problem(made, [records[0], records[1]._replace(weight=2.5)], ridge)
    alpha = of.alpha
    linearised = of.linearise(alpha, of.solve(alpha).beta)
    gradient = -2 * linearised.slopes.T @ linearised.error
    for k, slope in enumerate(gradient):
        differences = []
        for share in (1e-6, 1e-5, 1e-4):  # rounding spoils a short step, a kink within it a long one
            step = np.zeros_like(alpha)
            step[k] = share * max(abs(alpha[k]), 1e-3)
            apart = of.solve(alpha + step).objective - of.solve(alpha - step).objective
            differences.append(
                pytest.approx(apart / (2 * step[k]), rel=1e-3, abs=1e-6 * np.abs(gradient).max())
            )
        assert slope in differences


@given(seed=st.integers(0, 99), form=forms)
def test_weights_are_the_least_squares_solution_on_all_records(seed: int, form: dict[str, Any]) -> None:
    made = compensator(seed, **form)
    records = [pair(seed, 300, slice(20, None)), pair(seed + 1, 2600, slice(0, None, 3))]
    of = problem(made, records, 0.0)
    solved = of.solve(of.alpha)
    columns, wanted = [], []
    for record in records:
        with torch.no_grad():
            h, basis = made.play_states(record.motion)[0][0], made.weights.basis(record.motion.yd_dot)[0]
            of_record = linear_columns(made, [h], [basis], made.psi.shape[1])
        columns.append(of_record[record.counted].numpy())
        wanted.append(record.u[0, record.counted].numpy())
    phi, u = np.concatenate(columns), np.concatenate(wanted)
    left = phi @ np.linalg.lstsq(phi, u, rcond=None)[0] - u
    assert solved.mean_square == pytest.approx(np.mean(left**2), rel=1e-9)
    assert np.mean((phi @ solved.beta - u) ** 2) == pytest.approx(np.mean(left**2), rel=1e-9)
    of.put(of.alpha, solved.beta)
    errors = [(made.voltage(one.motion)[0] - one.u)[0, one.counted].detach() for one in records]
    assert torch.cat(errors).square().mean().item() == pytest.approx(solved.mean_square, rel=1e-9)


def test_a_play_that_never_moves_gets_zero_weight() -> None:
    made = DirectInverse(PERIOD, [0.0, 0.5, 1e3], range_um=4.0)
    for ridge in (0.0, 1e-8):
        of = ProjectedProblem(made, [pair(3, 500, slice(0, None))], ["c"], 1, 0, ridge)
        solved = of.solve(of.alpha)
        assert solved.beta[2] == 0 and np.isfinite(solved.beta).all()
        assert np.isfinite(of.linearise(of.alpha, solved.beta).slopes).all()


@given(seed=st.integers(0, 99), lead=st.integers(0, 2), creeps=st.booleans())
def test_thinned_rows_are_every_nth_row_of_the_whole(seed: int, lead: int, creeps: bool) -> None:
    made = compensator(seed, lead=lead, degree=1, creep_time_constants_s=[0.05] if creeps else [])
    with torch.no_grad():  # an increasing saturation keeps the turning points in place
        made.saturation.scaled.fill_(1.1)
    of = problem(made, [pair(seed, 900, slice(40, None))], 0.0)
    thinned = of.thinned(100)
    assert 90 < thinned.samples < 110
    whole, few = (_rows(one, made) for one in (of, thinned))
    assert np.array_equal(few, whole[:: 860 // 100])


def _rows(of: ProjectedProblem, made: DirectInverse) -> np.ndarray:
    """Return states and voltage at every row of the first record."""
    [record] = of.stretches
    ran = blocks(record, nonlinear(made), made.creep_decay.numpy(), derivative=False)
    return np.concatenate([np.column_stack([b.h, part.u]) for b, part in zip(ran, record, strict=True)])


@given(seed=st.integers(0, 99), cuts=st.lists(st.integers(1, 60), min_size=1, max_size=6))
def test_the_blockwise_qr_gives_the_triangle_of_all_rows(seed: int, cuts: list[int]) -> None:
    matrix = np.random.default_rng(seed).standard_normal((sum(cuts), 5))
    factor = ThinQR(5, 60)
    first = 0
    for cut in cuts:
        rows = factor.rows(cut)
        rows[:] = matrix[first : first + cut]
        factor.absorb(rows)
        first += cut
    assert np.array_equal(factor.triangle, np.triu(factor.triangle))
    np.testing.assert_allclose(factor.triangle.T @ factor.triangle, matrix.T @ matrix, atol=1e-10)


def test_a_record_of_weight_2_counts_as_two_copies_of_it() -> None:
    made = compensator(3, rate="linear", offset=True)
    one, other = pair(3, 400, slice(5, None)), pair(4, 700, slice(31, None))
    weighted = problem(made, [one._replace(weight=2.0), other], 0.0)
    twice = problem(made, [one, one, other], 0.0)
    assert weighted.solve(weighted.alpha).beta == pytest.approx(twice.solve(twice.alpha).beta, rel=1e-9)
