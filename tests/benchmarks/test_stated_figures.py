"""Figures on pages: each is measured, within its bounds and quoted as measured; short ones are repeated."""

import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import pytest

from benchmarks.figures import command, pages, record, table
from benchmarks.figures.figure import Figure, Measurement
from benchmarks.figures.measurements import DATA
from benchmarks.figures.registry import DEFINITIONS, FIGURES, MEASURED_PAGES, MEASUREMENTS

STATING = [
    pages.ROOT / "README.md",
    pages.ROOT / "benchmarks" / "README.md",
    *sorted(pages.ROOT.glob("docs/*.md")),
]
SHORT = [one for one in MEASUREMENTS if one.short]
WEIGHT = Figure("weight_g", "g", 1.0, 2.0, ".1f")


def test_exactly_the_registered_figures_are_recorded_with_their_commands() -> None:
    found = record.read()
    assert found.keys() == FIGURES.keys()
    for one in MEASUREMENTS:
        for figure in one.figures:
            entry = found[figure.name]
            assert entry["command"] == one.command, figure.name
            assert (entry["unit"], entry["bound"]) == (figure.unit, [figure.at_least, figure.at_most])
            assert entry["commit"] and entry["date"] and "Python" in entry["machine"], figure.name


def test_the_page_of_figures_matches_the_record_and_names_every_figure() -> None:
    text = table.PAGE.read_text(encoding="utf-8")
    assert text == table.page(MEASUREMENTS, record.read())
    assert [name for name in FIGURES if f"| `{name}` |" not in text] == []


def test_every_recorded_figure_is_within_its_bounds() -> None:
    assert command.outside(FIGURES, record.values(record.read())) == []


def test_pages_quote_measured_values_and_every_figure_is_quoted() -> None:
    assert pages.faults(pages.pages(), FIGURES, record.values(record.read())) == []


def test_every_number_with_a_unit_is_a_figure_or_a_definition() -> None:
    written = {*(pages.ROOT / page for page in MEASURED_PAGES), table.PAGE}
    stating = [path for path in STATING if path not in written]
    assert pages.unregistered(stating, DEFINITIONS) == []


@pytest.mark.parametrize("page", DEFINITIONS)
def test_definitions_appear_on_their_pages(page: str) -> None:
    text = (pages.ROOT / page).read_text(encoding="utf-8")
    assert [number for number in DEFINITIONS[page] if number not in text] == []


def test_names_of_measurements_and_figures_are_unique() -> None:
    names = [figure.name for one in MEASUREMENTS for figure in one.figures]
    assert len(names) == len(set(names))
    assert len({one.name for one in MEASUREMENTS}) == len(MEASUREMENTS)


@pytest.mark.long
@pytest.mark.parametrize("one", SHORT, ids=[one.name for one in SHORT])
def test_a_repeated_short_measurement_is_within_its_bounds(one: Measurement) -> None:
    if one.needs_recordings and not DATA.is_dir():
        pytest.skip("the recordings of real stages are not beside this checkout")
    found = one.values()
    assert command.outside(FIGURES, found) == []


@pytest.mark.parametrize("page", MEASURED_PAGES)
def test_a_generated_page_states_its_command_date_and_commit(page: str) -> None:
    text = (pages.ROOT / page).read_text(encoding="utf-8")
    assert MEASURED_PAGES[page] in text
    assert pages.MEASURED_ON.search(text)


class TestPages:
    @pytest.mark.parametrize(
        ("text", "value", "complaint"),
        [
            ("It weighs 1.5 g<!-- figure: weight_g -->.", 1.5, None),
            ("Between 1 and **1.5**<!-- figure: weight_g --> g.", 1.46, None),
            ("It is light<!-- in words: weight_g -->.", 1.9, None),
            ("It weighs 1.4 g<!-- figure: weight_g -->.", 1.5, "found 1.4, expected 1.5"),
            ("It weighs 1.5 kg<!-- figure: weight_g -->.", 1.5, "found the unit kg, expected g"),
            ("It weighs 1.5 g.", 1.5, "weight_g: found on no page"),
            ("Say `2<!-- figure: weight_g -->`.", 1.5, "weight_g: found on no page"),
            (
                "1.5 g<!-- figure: weight_g -->, 2 m<!-- figure: height -->",
                1.5,
                "height: found no such figure",
            ),
            ("1.5 g<!-- figure: weight_g -->", None, "found no value in docs/figures.json"),
        ],
    )
    def test_faults_in_quotations_are_found(
        self, tmp_path: Path, text: str, value: float | None, complaint: str | None
    ) -> None:
        page = tmp_path / "page.md"
        page.write_text(f"# Page\n\n{text}\n", encoding="utf-8")
        values = {} if value is None else {"weight_g": value}
        found = pages.faults([page], {"weight_g": WEIGHT}, values)
        if complaint is None:
            assert found == []
        else:
            assert len(found) == 1 and complaint in found[0]

    def test_a_comment_without_a_number_is_refused(self, tmp_path: Path) -> None:
        page = tmp_path / "page.md"
        page.write_text("It is heavy<!-- figure: weight_g -->.\n", encoding="utf-8")
        with pytest.raises(ValueError, match=r"page.md:1: found no number before the comment of weight_g"):
            list(pages.quotations([page]))

    def test_a_number_with_a_unit_is_a_figure_a_definition_or_a_fault(self, tmp_path: Path) -> None:
        page = tmp_path / "page.md"
        page.write_text(
            "1.5 nm<!-- figure: weight_g -->, `9 nm`, 2 plays, 10 V,\n```sh\nwait 3 s\n```\n1,500 µm/s.\n",
            "utf-8",
        )
        (fault,) = pages.unregistered([page], {"page.md": frozenset({"10 V"})})
        assert fault.startswith("page.md:5: found 1,500 µm/s, expected the comment of a figure behind it")

    def test_only_quoted_numbers_are_renewed(self, tmp_path: Path) -> None:
        page = tmp_path / "page.md"
        page.write_text("1 of 1.4 g<!-- figure: weight_g -->, or 1.4 g.\n", encoding="utf-8")
        renewed = pages.renew(page, {"weight_g": WEIGHT}, {"weight_g": 1.52})
        assert renewed == "1 of 1.5 g<!-- figure: weight_g -->, or 1.4 g.\n"


def weighing(value: float, name: str = "weight_g", calls: list[str] | None = None) -> Measurement:
    def measure() -> Mapping[str, float]:
        if calls is not None:
            calls.append(name)
        return {name: value}

    figure = Figure(name, "g", 1.0, 2.0, ".1f")
    return Measurement(f"weigh {name}", "weigh", (figure,), measure, about_s=1)


def interrupted() -> Mapping[str, float]:
    raise KeyboardInterrupt


class TestRun:
    def test_an_interrupted_run_resumes_where_it_stopped(self, tmp_path: Path) -> None:
        path, calls = tmp_path / "figures.json", []
        first, last = weighing(1.5, "first", calls), weighing(1.6, "last", calls)
        stopped = Measurement("stop", "stop", last.figures, interrupted, about_s=1)
        with pytest.raises(KeyboardInterrupt):
            command.measure([first, stopped], "code", print, path)
        due = [one for one in (first, last) if not command.measured(one, record.read(path), "code")]
        assert due == [last]
        assert command.measure(due, "code", print, path) == []
        assert calls == ["first", "last"]
        assert record.values(record.read(path)) == {"first": 1.5, "last": 1.6}

    def test_a_figure_measured_with_other_code_is_measured_again(self, tmp_path: Path) -> None:
        path, one = tmp_path / "figures.json", weighing(1.5)
        command.measure([one], "code", print, path)
        assert command.measured(one, record.read(path), "code")
        assert not command.measured(one, record.read(path), "other code")

    def test_a_failed_measurement_is_named_and_does_not_affect_the_others(self, tmp_path: Path) -> None:
        path = tmp_path / "figures.json"
        wrong = Measurement("wrong", "weigh", (WEIGHT,), lambda: {"height_m": 1.0}, about_s=1)
        failed = command.measure([wrong, weighing(1.5, "right")], "code", print, path)
        assert failed == ["wrong: wrong: found ['height_m'], expected ['weight_g']"]
        assert record.read(path).keys() == {"right"}

    def test_a_value_outside_its_bounds_is_recorded_and_reported(self, tmp_path: Path) -> None:
        path, one = tmp_path / "figures.json", weighing(2.5)
        assert command.measure([one], "code", print, path) == []
        values = record.values(record.read(path))
        assert command.outside({"weight_g": WEIGHT}, values) == ["weight_g: found 2.5, expected 1 to 2 g"]
        assert command.outside({"weight_g": WEIGHT}, {"weight_g": float("nan")}) != []

    def test_an_unregistered_figure_is_dropped_and_a_bound_is_updated(self, tmp_path: Path) -> None:
        path = tmp_path / "figures.json"
        command.measure([weighing(1.5), weighing(1.5, "height_m")], "code", print, path)
        kept = record.registered(record.read(path), {"weight_g": replace(WEIGHT, at_most=3.0)})
        assert kept.keys() == {"weight_g"} and kept["weight_g"]["bound"] == [1.0, 3.0]

    def test_the_estimated_duration_is_printed_before_and_during_the_run(self, tmp_path: Path) -> None:
        lines: list[str] = []
        due = [weighing(1.5, "first"), weighing(1.6, "last")]
        assert command.estimate(due) == "2 to make, about 2 s"
        command.measure(due, "code", lines.append, tmp_path / "figures.json")
        assert lines[0] == "[1/2] weigh first: about 1 s, 2 s to the end"

    def test_the_record_names_no_host_and_is_json(self, tmp_path: Path) -> None:
        path = tmp_path / "figures.json"
        command.measure([weighing(1.5)], "code", print, path)
        (entry,) = json.loads(path.read_text(encoding="utf-8"))["figures"].values()
        assert entry["bound"] == [1.0, 2.0] and entry["command"] == "weigh"
        assert entry["machine"].split()[1:3] == ["cores", "of"]
