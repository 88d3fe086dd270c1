"""The paper's claims: every experiment compares like with like and states its outcome."""

from typing import Any

import pytest

from tests.paper.short_run import short_run
from torchpi.paper import claims
from torchpi.paper.context import SHORT
from torchpi.paper.items import ITEMS

NAMES = ("polynomial", "jointly", "two_sets", "multisine", "above_80hz")


@pytest.fixture(scope="module")
def tried() -> dict[str, claims.Claim]:
    import json

    import numpy as np

    from torchpi.paper.stored import restore

    found = {}
    for name in NAMES:
        path = short_run() / "items" / f"{name}.npz"
        with np.load(path) as file:
            key = str(file["key"])
            assert json.loads(str(file["tree"]))["name"] == name
        result: Any = restore(ITEMS[name].result, key, path)
        found[name] = result[0].claim
    return found


@pytest.mark.parametrize("name", NAMES)
def test_variants_have_the_same_columns_and_claims_are_full_sentences(tried, name: str) -> None:
    claim = tried[name]
    columns = {tuple(variant) for variant in claim.variants.values()}
    assert len(columns) == 1 and len(claim.variants) >= 2
    assert all(value > 0 for variant in claim.variants.values() for value in variant.values())
    assert claim.statement.endswith(".") and claim.found.endswith(".")


def test_the_papers_method_has_the_same_error_in_every_experiment(tried) -> None:
    held_out = [
        next(iter(tried[name].variants.values()))[claims.HELD_OUT]
        for name in ("polynomial", "jointly", "two_sets", "multisine")
    ]
    assert held_out == pytest.approx([held_out[0]] * 4, rel=1e-2)


def test_a_multisine_and_two_recordings_are_better_as_the_paper_claims(tried) -> None:
    assert tried["multisine"].holds and tried["two_sets"].holds


def test_a_joint_search_fits_its_records_no_worse_than_two_stages(tried) -> None:
    two, *jointly = (variant["both records, rms V"] for variant in tried["jointly"].variants.values())
    assert max(jointly) <= 1.02 * two


def test_above_80_hz_each_frequency_has_a_row_with_both_methods(tried) -> None:
    variants = tried["above_80hz"].variants
    assert list(variants) == [f"{hz} Hz" for hz in SHORT.above_hz]
    assert {column.split(",")[0] for column in variants["80 Hz"]} == {"paper", "torchpi"}
