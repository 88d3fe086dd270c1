"""The default recipe beside its baselines, on simulated stages that are not its own equations."""

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parents[2] / "benchmarks"))

import recipe


@pytest.mark.parametrize("family", recipe.FAMILIES)
def test_the_recipe_is_no_worse_than_its_baselines_on_three_records(family: str) -> None:
    row = recipe.run(family, recipe.simulated(family, recipe.three_records, seed=1))
    assert row.ratio <= 1.0, row


def test_trained_on_two_sines_it_halves_the_error_on_triangles() -> None:
    row = recipe.run("plays", recipe.simulated("pi", recipe.two_sines, seed=1))
    assert row.ratio <= 0.6, row


def test_the_lag_of_a_stage_is_undone_though_one_sine_alone_was_recorded() -> None:
    row = recipe.run("plays", recipe.simulated("pi", recipe.one_sine, seed=2))
    assert row.ratio <= 0.7, row


def test_a_case_is_the_same_every_time() -> None:
    first, again = (recipe.simulated("preisach", recipe.one_sine, seed=2).load() for _ in range(2))
    for one, other in zip(first.train + first.heldout, again.train + again.heldout, strict=True):
        assert (one.u == other.u).all() and (one.y == other.y).all()
