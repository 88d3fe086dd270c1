"""The page of the paper: self-contained, in the paper's order, with the numbers of results.json."""

import json
import re
from typing import Any

import pytest
from matplotlib.text import Text

from tests.paper.short_run import short_run
from tests.report.test_diagnosis_page import without_scripts
from torchpi.paper.items import ITEMS
from torchpi.paper.result import Row
from torchpi.report import paper_page, words
from torchpi.report.paper_figures import FIGURES
from torchpi.report.paper_page import TEXTS


@pytest.fixture(scope="module")
def html() -> str:
    return (short_run() / "paper.html").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def results() -> dict[str, Any]:
    return json.loads((short_run() / "results.json").read_text(encoding="utf-8"))


def test_the_page_loads_nothing_external_and_is_small(html: str) -> None:
    assert not re.search(r"https?://|src=|@import|<link|<script|<iframe|<object|<img", without_scripts(html))
    assert len(html.encode()) < 3_000_000


def test_identifiers_are_unique_and_references_resolve(html: str) -> None:
    ids = re.findall(r'\bid="([^"]+)"', html)
    assert len(ids) == len(set(ids))
    referenced = {a or b for a, b in re.findall(r'href="#([^"]+)"|url\(#([^)]+)\)', html)}
    assert referenced <= set(ids)


def test_sections_follow_the_order_of_the_paper_with_title_and_figures(html: str) -> None:
    assert re.findall(r'<section id="([^"]+)"', html) == list(ITEMS)
    for name in ITEMS:
        assert TEXTS[name]["title"].replace("'", "&#39;") in html
    assert html.count('<svg class="figure"') == 1 + sum(len(drawn) for drawn in FIGURES.values())


def test_figures_are_in_the_order_of_the_paper() -> None:
    numbers = [int(name[3:]) for name in ITEMS if name.startswith("fig")]
    assert numbers == [3, 4, 5, 7, 8, 10, 12, 13]


def test_numbers_on_the_page_are_those_of_the_results(html: str, results: dict[str, Any]) -> None:
    values = {float(value) for value in re.findall(r'<data value="([^"]+)"', html)}
    promised = [
        results["fig3"]["round_trip"],
        *results["fig7"]["area"].values(),
        *results["fig8"]["indirect_max_percent"].values(),
        *results["fig8"]["direct_max_percent"].values(),
        *(one["max_um"] for one in results["calibration"].values()),
        *(one["width_percent"] for one in results["fig13"]["after"].values()),
        *(results["fig12"]["torchpi"][name]["max_percent"] for name in ("slow", "fast")),
        *(one["max_percent"] for one in results["unseen"].values()),
    ]
    assert set(promised) <= values


def test_unmet_requirements_are_reported(html: str) -> None:
    """The short run uses the paper's compensator, which misses the values required of torchpi's."""
    assert "not reached: " in html and "✗" in html and "✓" in html


def test_every_figure_is_also_written_as_a_separate_file() -> None:
    names = {path.stem for path in (short_run() / "figures").iterdir()}
    assert names == {draw.__name__ for drawn in FIGURES.values() for draw, _ in drawn}


def test_text_in_figures_is_eight_points_or_more_and_axes_have_units(monkeypatch) -> None:
    seen = []
    monkeypatch.setattr(paper_page, "inline_svg", lambda figure, *_: seen.append(figure) or "<svg></svg>")
    for section in _sections():
        paper_page.paper_page([section], [], _PROVENANCE)
    assert len(seen) == 1 + sum(len(drawn) for drawn in FIGURES.values())
    for figure in seen:
        assert min(text.get_fontsize() for text in figure.findobj(Text) if text.get_text()) >= 8
        for axes in figure.axes:
            label = axes.get_ylabel()
            assert not label or "(" in label or "%" in label


def test_missing_results_are_named_and_text_is_escaped() -> None:
    html = paper_page.paper_page([], ["fig3", "<b>"], _PROVENANCE)
    assert "not been computed yet: fig3, &lt;b&gt;" in html


@pytest.mark.parametrize(
    ("value", "text"),
    [(0.0999996, "0.100"), (4.88e-15, "4.88e−15"), (11.0, "11.0"), (24, "24"), (-0.22, "−0.220"), (0.0, "0")],
)
def test_numbers_have_three_significant_digits_and_counts_stay_integers(value: float, text: str) -> None:
    assert paper_page._shown(value) == text


@pytest.mark.parametrize(
    ("value", "text"), [(0.333, "+0.33 %"), (-0.0934, "−0.093 %"), (-71.4, "−71 %"), (123.4, "+123 %")]
)
def test_a_small_difference_is_not_rounded_to_zero(value: float, text: str) -> None:
    assert paper_page._signed_percent(value) == text


def test_rows_are_marked_as_met_or_missed() -> None:
    rows = [Row("a", 0.4, at_most=0.5), Row("b", 0.6, at_most=0.5)]
    section = paper_page.Section("learning", None, rows, 1.0)
    html = paper_page.paper_page([section], [], _PROVENANCE)
    assert '<tr class="met">' in html and '<tr class="missed">' in html
    assert "Of 2 required values, 1 are" in html
    assert "<strong>1 of 2</strong>" in html


def test_the_first_number_compares_both_methods_on_the_fast_trajectory(
    html: str, results: dict[str, Any]
) -> None:
    first = html[: html.index("<section")]
    paper, ours = (
        words.figure(results["fig12"][method]["fast"]["max_percent"], 2) for method in ("paper", "torchpi")
    )
    assert f"<strong>{paper} % → {ours} %</strong>" in first


def _sections() -> list[paper_page.Section]:
    import numpy as np

    from torchpi.paper.stored import restore

    sections = []
    for name, item in ITEMS.items():
        path = short_run() / "items" / f"{name}.npz"
        with np.load(path) as file:
            key = str(file["key"])
        result, seconds = restore(item.result, key, path)
        sections.append(paper_page.Section(name, result, result.rows(), seconds))
    return sections


_PROVENANCE = paper_page.Provenance(command="torchpi reproduce", seed=None, files={}, versions={}, machine="")
