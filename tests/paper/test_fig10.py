"""Fig. 10 and Table I: the paper's two-stage identification from recordings of the stage."""

import numpy as np
import pytest
import torch

from tests.paper.short_run import STAGE
from torchpi.paper.fig10 import EQ_12, Fig10, Identified, fig10, identify, saturation
from torchpi.stage import Stage


@pytest.fixture(scope="module")
def identified() -> Identified:
    return identify(Stage.from_yaml(STAGE).requires_grad_(False))


@pytest.fixture(scope="module")
def figure(identified: Identified) -> Fig10:
    return fig10(identified)


def test_the_error_is_largest_in_the_initial_loading_as_in_the_paper(figure: Fig10) -> None:
    assert figure.whole.max_v > figure.after_loading.max_v
    assert 0.0 < figure.loading_s < 0.1  # within the first period of eq. 13


def test_reported_errors_are_those_of_the_traces(figure: Fig10) -> None:
    error = figure.u_model - figure.u
    assert figure.whole.max_v == pytest.approx(np.abs(error).max())
    assert figure.whole.rms_v == pytest.approx(np.sqrt(np.mean(error**2)))
    end = round(figure.loading_s * 1e4)
    assert figure.after_loading.max_v == pytest.approx(np.abs(error[end:]).max())


def test_each_record_has_at_least_five_thousand_samples(identified: Identified) -> None:
    assert min(len(identified.slow), len(identified.fast)) >= 5_000


def test_the_model_can_be_rebuilt_from_table_1(identified: Identified, figure: Fig10) -> None:
    """Eq. 8 is evaluated directly from k, b, c and the thresholds."""
    motion = identified.pairs[1].motion
    s = saturation(figure.c, motion.yd[0].numpy())
    rate = motion.yd_dot[0].numpy()
    u = np.zeros_like(s)
    for r, k, b in zip(identified.compensator.plays.r.tolist(), figure.k, figure.b, strict=True):
        h, held = np.empty_like(s), 0.0
        for t, x in enumerate(s):
            held = max(x - r, min(x + r, held))
            h[t] = held
        u += (k * rate + b) * h
    np.testing.assert_allclose(np.clip(u, 0, 10), figure.u_model, atol=1e-9)


def test_eq_12_has_the_expected_values() -> None:
    assert saturation(EQ_12, np.array([8.1, 4.05])) == pytest.approx([10.805, 5.181], abs=1e-3)
    x = torch.linspace(0, 8.1, 812, dtype=torch.float64).numpy()
    slope = np.gradient(saturation(EQ_12, x), x)
    assert slope[1:-1].min() == pytest.approx(1.243, abs=2e-3)
