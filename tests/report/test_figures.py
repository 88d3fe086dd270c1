"""Figures are small, legible and drawn without losing peaks."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from matplotlib.figure import Figure
from matplotlib.text import Text

from torchpi.report import loop_figures, training_figures
from torchpi.report.style import canvas
from torchpi.report.svg import inline_svg
from torchpi.report.traces import envelope, readable, thinned


@pytest.fixture(scope="module")
def figures(results, training) -> list[Figure]:
    loop = (
        loop_figures.trajectory_figure,
        loop_figures.linearity_figure,
        loop_figures.error_figure,
        loop_figures.voltage_figure,
        loop_figures.latency_figure,
    )
    record = (training_figures.loop_figure, training_figures.traces_figure, training_figures.spectrum_figure)
    return [
        *(draw(results[0]) for draw in loop),
        *(draw(training.records[0]) for draw in record),
        training_figures.weights_figure(training.weights),
        training_figures.saturation_figure(training.saturation),
    ]


def test_axes_are_labelled_with_their_units(figures: list[Figure]):
    for figure in figures:
        labels = [axes.get_ylabel() for axes in figure.axes] + [figure.axes[-1].get_xlabel()]
        assert any("(" in label or "per" in label for label in labels)
        assert figure.axes[-1].get_xlabel()
        assert figure.axes[0].get_ylabel()


def test_text_is_eight_points_or_more(figures: list[Figure]):
    for figure in figures:
        sizes = [text.get_fontsize() for text in figure.findobj(Text) if text.get_text()]
        assert min(sizes) >= 8


def test_powers_of_ten_are_plain_text() -> None:
    with canvas(2.0) as figure:
        axes = figure.subplots()
        axes.plot([1e-3, 1e2], [2e-5, 7e-5])
        axes.set(xscale="log", yscale="log")
    svg = inline_svg(figure, "a", "")
    assert ">10⁻³</text>" in svg and ">10²</text>" in svg and ">3×10⁻⁵</text>" in svg


def test_the_svg_of_a_figure_is_reproducible(figures: list[Figure]):
    for figure in figures:
        first = inline_svg(figure, "a", 'says "hello" & <more>')
        assert first == inline_svg(figure, "a", 'says "hello" & <more>')
        assert first.startswith('<svg class="figure"')
        assert 'aria-label="says &quot;hello&quot; &amp; &lt;more>"' in first
        assert len(first) < 300_000


@given(st.integers(1, 4000), st.integers(1, 300), st.integers(0, 2**31))
def test_an_envelope_keeps_every_peak_and_the_order(samples: int, columns: int, seed: int):
    t, y = np.arange(samples, dtype=float), np.random.default_rng(seed).standard_normal(samples)
    short_t, short_y = envelope(t, y, columns)
    assert len(short_y) <= max(2 * columns + 2, 1)
    assert (short_y.max(), short_y.min()) == (y.max(), y.min())
    assert (np.diff(short_t) > 0).all()
    assert (y[short_t.astype(int)] == short_y).all()


def test_a_thinned_curve_stays_within_a_dot_of_the_original():
    angle = np.linspace(0, 4 * np.pi, 20_000)
    x, y = np.cos(angle), np.sin(3 * angle)
    short_x, short_y = thinned(x, y, 1 / 500)
    assert len(short_x) < len(x) / 2
    distance = np.hypot(x[::197, None] - short_x, y[::197, None] - short_y).min(axis=1)
    assert distance.max() < 2 * np.sqrt(2) / 500


def test_a_motion_of_many_periods_is_first_shown_in_part_and_one_of_few_in_full():
    t = np.arange(20_000) / 1e4
    noise = 0.01 * np.random.default_rng(0).standard_normal(len(t))
    many = readable(np.sin(2 * np.pi * 100 * t) + noise)
    assert (many.stop - many.start) / 1e4 == pytest.approx(24 / 200, rel=0.05)
    assert (many.stop + many.start) / 2 == pytest.approx(len(t) / 2, rel=0.02)
    assert readable(np.sin(2 * np.pi * 5 * t) + noise) == slice(0, len(t))
    assert readable(np.zeros(10)) == slice(0, 10)


def test_loops_are_drawn_as_errors_so_that_their_opening_is_visible(results):
    both, alone = loop_figures.linearity_figure(results[0]).axes
    drive = results[0].compensated
    steady = 1e3 * (drive.y_true - results[0].yd)[results[0].loading_samples :]
    for axes in (both, alone):
        drawn = next(line.get_ydata() for line in axes.lines if line.get_label() == drive.label)
        assert drawn.min() == pytest.approx(steady.min(), abs=1) and len(drawn) > 100
        assert axes.get_ylabel() == "error, y − reference (nm)"
    assert len([line for line in both.lines if line.get_label() == "without compensation"]) == 1


def test_the_loading_is_not_shaded_if_it_fills_most_of_the_figure(results):
    import dataclasses

    late = dataclasses.replace(results[0], loading_samples=int(0.8 * len(results[0].t)))
    assert loop_figures.loading_s(late) is None and loop_figures.loading_s(results[0]) is not None


def test_a_trajectory_without_a_loading_phase_has_no_loading_label(results):
    import dataclasses

    figure = loop_figures.trajectory_figure(dataclasses.replace(results[0], loading_samples=0))
    assert not [text for text in figure.findobj(Text) if text.get_text() == "loading"]
