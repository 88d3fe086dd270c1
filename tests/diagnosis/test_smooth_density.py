"""The prior of a Preisach operator's density, and its slow terms."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from tests.diagnosis.plants import pair
from tests.diagnosis.prepared import prepared
from torchpi.diagnosis.hysteresis_model import HysteresisModel, duhem, many_plays, preisach
from torchpi.diagnosis.outside import Outside
from torchpi.diagnosis.records import seen
from torchpi.diagnosis.smooth_density import cosines, roughness, terms
from torchpi.stage.effects.effect import DataRange


@pytest.mark.parametrize(("pieces", "plays"), [(5, 7), (12, 4), (200, 1), (3, 2)])
def test_terms_are_the_principal_components_of_the_prior(pieces: int, plays: int) -> None:
    rows = terms(pieces, plays)
    slopes = rows.reshape(len(rows), pieces, plays)
    lines, bent = slopes[:plays], slopes[plays:]
    rough = roughness(bent)
    np.testing.assert_allclose(rough @ rough.T, np.eye(len(bent)), atol=1e-9)
    np.testing.assert_allclose(bent.sum(1), 0.0, atol=1e-9)
    assert (lines == np.eye(plays)[:, None]).all() and not roughness(lines).any()
    if pieces * plays < 100:
        assert np.linalg.matrix_rank(rows) == pieces * plays


@pytest.mark.parametrize("larger", [many_plays, lambda s: preisach(s, 6), duhem])
def test_unreduced_rows_are_independent_under_the_prior(
    larger: Callable[[DataRange], HysteresisModel],
) -> None:
    nominal = larger(seen(prepared(pair(2000))))
    variances = nominal.inverse_variances(3.0, 2.0)
    if nominal.pieces > 1:
        variances[0] = 0.0  # the linear term of a curve
    np.testing.assert_allclose(nominal.inverse_covariance(3.0, 2.0), np.diag(variances), atol=1e-9)


def test_the_linear_term_of_a_curve_has_a_prior_only_beside_a_simulation() -> None:
    alone = preisach(seen(prepared(pair(2000))), 6)
    beside = replace(alone, simulation=Outside(None)).unreduced
    assert alone.inverse_covariance(3.0, 2.0)[0, 0] == 0.0
    assert beside.inverse_covariance(3.0, 2.0)[0, 0] == pytest.approx(3.0)


def test_the_roughness_of_a_density_does_not_depend_on_the_grid() -> None:
    def cost(cells: int) -> float:
        along = np.linspace(0, 3, cells)[:, None]
        of = 0.5 + np.sin(along) * np.cos(np.linspace(0, 2, cells))
        slopes = np.concatenate([np.cos(along), of / cells], 1)[None]
        return float(np.sum(roughness(slopes) ** 2))

    assert cost(200) == pytest.approx(cost(50), rel=0.1)


def test_cosines_are_orthonormal_and_cost_their_squared_differences() -> None:
    rows, costs = cosines(9)
    np.testing.assert_allclose(np.sum(np.diff(rows, axis=1) ** 2, 1), costs, atol=1e-12)
    np.testing.assert_allclose(rows @ rows.T, np.eye(9), atol=1e-12)
