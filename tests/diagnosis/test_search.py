"""The search: which of two fits it goes on with."""

from types import SimpleNamespace

import numpy as np
import pytest

from torchpi.diagnosis.search import Search


@pytest.mark.parametrize(
    ("bounded", "rms", "taken"), [((), 0.5, True), (("beta",), 0.5, False), ((), 1.5, False)]
)
def test_a_refit_is_taken_where_it_leaves_less_and_runs_into_no_bound(
    bounded: tuple[str, ...], rms: float, taken: bool
) -> None:
    before, after = (
        SimpleNamespace(
            bounded=each,
            on_a_bound=[SimpleNamespace(name=name, member=-1) for name in each],
            train_rms=size,
            hypothesis=SimpleNamespace(members=()),
            weights=None,
        )
        for each, size in (((), 1.0), (bounded, rms))
    )
    search = object.__new__(Search)
    weighting = SimpleNamespace(log_density=lambda fit: np.array([0.0 if fit is after else -1.0]))
    search.chain, search.repeating = SimpleNamespace(weighting=weighting), []
    search.weigh, search.fits_here = lambda fit: None, lambda jobs: [after]
    assert search.at_its_own_weights(before) is (after if taken else before)
    assert search.chain.weighting is weighting
