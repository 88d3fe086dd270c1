"""The default recipe against its baselines, on simulated stages with equations other than its own."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[2] / "benchmarks"))

import recipe


def test_the_recipe_is_no_worse_than_its_baselines_on_three_records_of_another_operator() -> None:
    """`benchmarks/recipe.py` runs every family."""
    row = recipe.run("bouc_wen", recipe.simulated("bouc_wen", recipe.three_records, seed=1))
    assert row.ratio <= 1.0, row


def test_the_recipe_trained_on_two_sines_clearly_beats_its_baselines_on_triangles() -> None:
    row = recipe.run("plays", recipe.simulated("pi", recipe.two_sines, seed=1))
    assert row.ratio <= 0.6, row


def test_the_lag_of_a_stage_is_compensated_from_a_single_sine() -> None:
    row = recipe.run("plays", recipe.simulated("pi", recipe.one_sine, seed=2))
    assert row.ratio <= 0.7, row


def test_a_simulated_case_is_reproducible() -> None:
    first, again = (recipe.simulated("preisach", recipe.one_sine, seed=2).load() for _ in range(2))
    for one, other in zip(first.train + first.heldout, again.train + again.heldout, strict=True):
        assert (one.u == other.u).all() and (one.y == other.y).all()
