"""Normal equations: the units of the numbers do not matter, and numbers without effect do not move."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from torchpi.diagnosis.normal_equations import eliminated, solve, solve_positive, to_unit_diagonal


def rows(seed: int, numbers: int = 6, samples: int = 40) -> np.ndarray:
    return np.random.default_rng(seed).standard_normal((numbers, samples))


@given(st.integers(0, 2**31), st.lists(st.integers(-60, 60), min_size=6, max_size=6))
def test_a_step_scales_with_the_units_of_its_numbers(seed: int, powers: list[int]) -> None:
    j, error, unit = rows(seed), rows(seed + 1, 1)[0], 2.0 ** np.array(powers)
    step = solve(j @ j.T, j @ error)
    np.testing.assert_allclose(step, np.linalg.lstsq(j.T, error, rcond=None)[0], rtol=1e-6, atol=1e-8)
    in_units = unit[:, None] * j
    np.testing.assert_allclose(solve(in_units @ in_units.T, in_units @ error) * unit, step, rtol=1e-9)


@pytest.mark.parametrize("sensitivity", [0.0, 1e-160])
def test_a_number_without_effect_does_not_move_and_changes_no_other(sensitivity: float) -> None:
    j, error = rows(3), rows(4, 1)[0]
    idle = np.concatenate([j, sensitivity * j[:1]])
    step = solve(idle @ idle.T, idle @ error)
    assert step[-1] == 0.0
    np.testing.assert_allclose(step[:-1], solve(j @ j.T, j @ error), rtol=1e-12)
    assert np.diag(to_unit_diagonal(idle @ idle.T, 0.0)[0]) == pytest.approx([1.0] * 6 + [0.0])


def test_damping_shortens_the_step_of_the_damped_numbers_only_through_these() -> None:
    j, error = np.eye(4, 40) * np.arange(1, 5)[:, None], np.ones(40)
    free, damped = solve(j @ j.T, j @ error), solve(j @ j.T, j @ error, 2, 3.0)
    np.testing.assert_allclose(damped, free * [1, 1, 1 / 4, 1 / 4], rtol=1e-6)


def test_equal_rows_share_a_step_and_an_indefinite_system_is_still_solved() -> None:
    j, error = np.repeat(rows(5, 1), 2, axis=0), rows(6, 1)[0]
    step = solve(j @ j.T, j @ error)
    np.testing.assert_allclose(step, 0.5 * float(j[0] @ error / (j[0] @ j[0])), rtol=1e-6)
    indefinite, right = np.diag([1.0, -2.0]), np.array([3.0, 4.0])
    np.testing.assert_allclose(solve_positive(indefinite, right), [3.0, -2.0])


def test_elimination_leaves_what_the_others_cannot_imitate() -> None:
    j, others = rows(7, 3), rows(8, 2)
    inside = np.linalg.inv(others @ others.T)
    left = j - (j @ others.T) @ inside @ others
    np.testing.assert_allclose(
        eliminated(j @ j.T, j @ others.T, others @ others.T), left @ left.T, atol=1e-12
    )
