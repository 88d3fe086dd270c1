"""The pages: self-contained, with exactly the numbers of the results."""

import json
import re
from dataclasses import replace
from html.parser import HTMLParser

import pytest

from tests.report.test_diagnosis_page import without_scripts
from torchpi.loop.result import COMPENSATED, LimitMet, LoopResult
from torchpi.report import words
from torchpi.report.page import loop_json, write_loop_report, write_training_report
from torchpi.report.training import TrainingReport
from torchpi.report.what_was_run import Provenance, provenance


class Collector(HTMLParser):
    """Tags with their attributes, and the text of <data> elements by table, row and order."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.numbers: dict[tuple[int, str | None, str | None], list[tuple[float, str]]] = {}
        self._section, self._table, self._row, self._value = 0, None, None, None
        self.feed(html)

    def handle_starttag(self, tag, attrs):
        attributes = dict(attrs)
        self.tags.append((tag, attributes))
        if tag == "section":
            self._section += 1
        elif tag == "table":
            self._table = attributes.get("data-signal")
        elif tag == "tr":
            self._row = attributes.get("data-drive") or attributes.get("data-part")
        elif tag == "data":
            self._value = float(attributes["value"])

    def handle_data(self, data):
        if self._value is not None:
            place = (self._section, self._table, self._row)
            self.numbers.setdefault(place, []).append((self._value, data))
            self._value = None


@pytest.fixture(params=["loop_html", "training_html"])
def html(request) -> str:
    return request.getfixturevalue(request.param)


def test_a_page_loads_nothing_external(html: str):
    assert not re.search(r"https?://|src=|@import|<link|<script|<iframe|<object|<img", without_scripts(html))
    for _, attributes in Collector(html).tags:
        assert (attributes.get("href") or "#").startswith("#")
    assert all(target.startswith("#") for target in re.findall(r"url\(([^)]*)\)", html))


def test_identifiers_are_unique_and_references_resolve(html: str):
    tags = Collector(html).tags
    ids = [attributes["id"] for _, attributes in tags if "id" in attributes]
    assert len(ids) == len(set(ids))
    referenced = set(re.findall(r'href="#([^"]+)"|url\(#([^)]+)\)', html))
    assert {a or b for a, b in referenced} <= set(ids)


def test_a_page_is_small(html: str):
    assert len(html.encode()) < 2_000_000


def test_external_text_is_escaped(html: str):
    assert "&lt;b&gt;.yaml" in html
    assert "<b>" not in html


def test_numbers_on_the_loop_page_are_those_of_the_json(
    loop_html: str, results: list[LoopResult], provenance: Provenance
):
    numbers = Collector(loop_html).numbers
    content = json.loads(loop_json(results, provenance))
    assert [run["name"] for run in content["trajectories"]] == ["slow", "fast"]
    for section, run in enumerate(content["trajectories"], start=1):
        assert list(run["drives"])[-1] == COMPENSATED
        for key, drive in run["drives"].items():
            for signal, json_key in (("on_true", "true_displacement"), ("on_sensor", "sensor_reading")):
                expected = [
                    drive[json_key][part][f"{size}_{unit}"]
                    for part in ("loading", "steady", "whole")
                    for size in ("max", "rms")
                    for unit in ("um", "percent", "percent_of_range")
                ]
                if signal == "on_true" and key != "without":
                    better = drive["times_better_than_without"]
                    expected += [better["whole_rms"], better["steady_rms"]]
                shown = numbers[(section, signal, key)]
                assert [value for value, _ in shown] == expected
                assert [text for _, text in shown] == [words.figure(value) for value in expected]
            latency = drive["latency"]
            expected = [latency[f"{name}_us"] for name in ("median", "p99", "p999", "max")]
            expected += [drive["loop_width_um"], drive["loop_width_percent"]]
            assert [value for value, _ in numbers[(section, "latency", key)]] == expected


def test_numbers_on_the_training_page_are_those_of_the_metrics(training_html: str, training: TrainingReport):
    numbers = Collector(training_html).numbers
    for part, row in training.metrics.items():
        expected = [row[f"{size}_{unit}"] for unit in ("v", "um", "percent") for size in ("rms", "max")]
        assert [value for value, _ in numbers[(1, None, part)]] == expected


def test_the_headline_states_the_tracking_error(results: list[LoopResult]):
    result = results[1]
    whole = result.compensated.on_true.whole
    sentence = words.headline(result)
    assert sentence.startswith(f"Tracks eq. 16 (fast) to {words.figure(whole.rms_um)} µm rms")
    assert f"of {result.compensated.latency.steps:,} deadlines missed" in sentence


def test_reports_are_reproducible_to_the_last_byte(tmp_path, results, provenance, training, training_html):
    page, numbers = write_loop_report(results[:1], provenance, tmp_path / "new")
    again, _ = write_loop_report(results[:1], provenance, tmp_path / "again")
    assert page.read_bytes() == again.read_bytes()
    assert numbers.read_text(encoding="utf-8") == loop_json(results[:1], provenance)
    report = write_training_report(training, provenance, tmp_path / "report.html")
    assert report.read_text(encoding="utf-8") == training_html
    pictures = sorted(path.name for path in (tmp_path / "new" / "figures").iterdir())
    names = ("error", "latency", "linearity", "trajectory", "voltage")
    assert pictures == [f"slow_{name}.png" for name in names]
    assert sorted(path.name for path in (tmp_path / "new").iterdir()) == ["figures", "loop.html", "loop.json"]


def test_provenance_hashes_the_files(tmp_path):
    path = tmp_path / "a.pt"
    path.write_bytes(b"abc")
    gathered = provenance("torchpi run a.pt", {"compensator": path}, seed=1)
    (sha256,) = gathered.files.values()
    assert sha256 == "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"


def test_reaching_a_limit_is_reported_with_any_excess_over_it(results: list[LoopResult]):
    met = LimitMet("voltage", 10.0, 10.0, 0.01, 1, 0.5, 0.001, 8.0)
    sentences = [
        words.limits(with_limits(results[0], one))[0]
        for one in (met, replace(met, quantity="slew", limit=80.0, value=81.0))
    ]
    assert "the voltage reaches its limit of 10 V from 0.5 s for 1 ms" in sentences[0]
    assert "reaches its limit of 80 V/s (at most 81 V/s) from 0.5 s" in sentences[1]


def with_limits(result: LoopResult, met: LimitMet) -> LoopResult:
    drives = {**result.drives, COMPENSATED: replace(result.compensated, limits_met=(met,))}
    return replace(result, drives=drives)


def test_the_check_page_begins_with_whether_the_files_are_usable(check_html: str):
    first = check_html[: check_html.index("<section")]
    assert "<strong>Usable</strong> both recordings, without a warning" in first
    assert "<b>slow</b>: 10,000 Hz, 0.8 s, noise about 2.0 nm" in first and "linked-data" in first


@pytest.mark.parametrize(
    ("value", "text"),
    [(0.02134, "0.0213"), (4.1, "4.10"), (127.4, "127"), (12_345.6, "12,346"), (0.0, "0"), (-0.5, "−0.500")],
)
def test_figures_have_three_significant_digits(value: float, text: str):
    assert words.figure(value) == text


@pytest.mark.parametrize(
    ("ratio", "text"),
    [
        (14.9, "14 times better"),
        (9.98, "9.9 times better"),
        (1.3, "1.3 times better"),
        (0.5, "2.0 times worse"),
        (0.0, "∞ times worse"),
        (float("inf"), "∞ times better"),
    ],
)
def test_a_ratio_never_sounds_better_than_it_is(ratio: float, text: str):
    assert words.times(ratio) == text
