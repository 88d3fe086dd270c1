"""The page says what the results say: every rate with its count and bound, every goal that was missed."""

from pathlib import Path

import numpy as np
import pytest
from concealed.cases import Case
from concealed.judging.grade import Grade
from concealed.judging.proportions import share
from concealed.judging.summary import FIGURES, summarise
from concealed.page import cases
from concealed.page.text import GOALS, cell, figure_table, reached, write_page


def graded(
    case: int, *, track: str = "alien", truth: str = "creep", named: str = "creep", **more: object
) -> Grade:
    right = truth == named
    stated = [{"name": named, "probability": 0.8, "right": right, "right_group": right}] if named else []
    given = {
        "track": track,
        "case": f"case_{case:04d}",
        "truth": [truth] if truth else [],
        "unknown": [],
        "family": "duhem",
        "severities": {truth: 8.0} if truth else {},
        "beyond_plays": {truth: 4.0} if truth else {},
        "verdict": "explained" if named else "nothing_missing",
        "named": [named] if named else [],
        "exact": [truth] if right and truth else [],
        "found": [truth] if right and truth else [],
        "wrong": [] if right or not named else [named],
        "tolerated": [],
        "null": not truth,
        "forms": {truth: "power_law"} if truth else {},
        "heldout_over_noise": 1.1,
        "diagnose_s": 12.0,
        "stated": stated,
    }
    return Grade(**given | more)


def results(*grades: Grade) -> dict:
    return {
        "entry": "tool",
        "commit": "0123456789abcdef",
        "drawn": "2030-01-01T00:00:00+00:00",
        "diagnose": "tool diagnose",
        "predict": "",
        "seeds": {"alien": 12345},
        "counts": {"alien": len(grades)},
        **summarise(grades),
        "said": {"alien/case_0009": "The stage lacks hum."},
        "cases": [grade.as_dict() for grade in grades],
    }


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    tmp_path = tmp_path_factory.mktemp("page")
    tool = results(
        *(graded(k) for k in range(1, 9)),
        graded(9, named="hum"),
        graded(10, truth="", named=""),
        graded(11, track="crime"),
    )
    rival = results(*(graded(k, named="hum") for k in range(1, 11)))
    write_page({"tool": tool, "rival": rival}, tmp_path / "proof.md")
    assert {p.name for p in (tmp_path / "proof").iterdir()} == {
        "confusion.svg",
        "detection.svg",
        "reliability.svg",
    }
    return tmp_path


@pytest.fixture
def page(folder: Path) -> str:
    return (folder / "proof.md").read_text()


class TestPage:
    def test_rates_stand_with_count_and_bound_beside_the_rivals(self, page):
        low = share(8, 9)["at_least"]
        expected = f"| 88.9 % (8/9; ≥ {100 * low:.1f} %) | 0.0 % (0/10; ≥ 0.0 %) |"
        assert expected in next(line for line in page.splitlines() if line.startswith("| right group, 2 ×"))

    def test_commit_seeds_and_commands_are_there(self, page):
        for text in ("0123456789ab", "12345", "2030-01-01", "tool diagnose"):
            assert text in page

    def test_what_falls_short_is_said_and_what_does_not_is_not(self, page):
        missed = page.split("## What it cannot do")[1]
        assert (
            "right group, 2 × the noise and more: 88.9 %" in missed
            and "precision when it names: 88.9 %" in missed
        )
        assert "exact name where separable" not in missed

    def test_the_worst_case_is_dissected_and_tables_have_effect_form_and_truth(self, page):
        worst = page.split("## The ten worst cases")[1].split("##")[0]
        assert "alien/case_0009 | duhem | creep 8.0 | explained: hum | hum | 1.1 |" in worst
        assert "| creep: power_law | 9 |" in page and "| duhem | 10 |" in page

    def test_the_same_results_give_the_same_pictures(self, folder, tmp_path):
        before = {p.name: p.read_bytes() for p in (folder / "proof").iterdir()}
        tool = results(
            *(graded(k) for k in range(1, 9)),
            graded(9, named="hum"),
            graded(10, truth="", named=""),
            graded(11, track="crime"),
        )
        write_page({"tool": tool}, tmp_path / "proof.md")
        assert {p.name: p.read_bytes() for p in (tmp_path / "proof").iterdir()} == before

    def test_the_worst_cases_are_drawn_again_from_their_seeds(self, tmp_path, monkeypatch):
        t = np.arange(300) / 100
        run = {"time_s": t, "input_v": np.sin(t), "output_um": np.sin(t) + 0.1 * t}
        asked = []
        monkeypatch.setattr(
            cases, "draw", lambda *case: asked.append(case) or Case([run], {"noise_rms_um": 0.01})
        )
        write_page({"tool": results(graded(9, named="hum"))}, tmp_path / "proof.md", tmp_path)
        assert asked == [("alien", 12345, 8, tmp_path)]
        assert (tmp_path / "proof" / "alien_case_0009.svg").stat().st_size > 0
        page = (tmp_path / "proof.md").read_text()
        assert page.count("](proof/alien_case_0009.svg)") == 2  # among the worst, and as a story
        story = page.split("### alien/case_0009")[1]
        assert "1 recording of duhem, 300 samples at 100 Hz, 0 to 1 V." in story
        assert "**Concealed**: creep (power law), 8 × the noise." in story
        assert "“The stage lacks hum.”" in story
        assert "**Right**: none; wrong: hum; verdict: explained." in story

    def test_stories_are_the_first_of_their_kind_whatever_came_of_them(self):
        two = {"creep": 4.0, "hum": 3.0}
        grades = [
            graded(1, track="open"),
            graded(2, truth="", named="hum"),
            graded(3, named="hum"),
            graded(4),
            graded(5, severities=two),
            graded(6, severities=two),
            graded(7, truth="", named=""),
            *(graded(k, track="noise", injected=True) for k in (1, 3, 5)),
        ]
        told = ["alien/case_0003", "alien/case_0005", "alien/case_0002", "noise/case_0001", "noise/case_0003"]
        assert summarise(grades)["stories"] == told

    def test_a_run_without_anything_to_count_has_a_page(self, tmp_path):
        failed = graded(
            1, truth="creep", named="", verdict="failed", failed="no answer", heldout_over_noise=None
        )
        write_page({"tool": results(failed)}, tmp_path / "proof.md")
        assert "no answer that can be graded" in (tmp_path / "proof.md").read_text()

    def test_tracks_have_a_column_each_and_their_mean(self):
        table = figure_table({"tool": results(graded(1), graded(2, track="open", named="hum"))}, tracks=True)
        assert table.splitlines()[0] == "|  | alien | open | mean |"
        assert next(line for line in table.splitlines() if line.startswith("| precision")).endswith("| 0.5 |")


class TestGoals:
    def test_every_goal_is_one_of_the_figures(self):
        assert GOALS.keys() <= {key for key, *_ in FIGURES}

    @pytest.mark.parametrize(
        ("key", "value", "met"),
        [
            ("false_alarms", share(0, 299), True),
            ("false_alarms", share(0, 100), False),  # none of so few is no proof of 2 %
            ("false_alarms", share(2, 100), False),
            ("precision", share(980, 1000), True),
            ("precision", share(98, 100), False),
            ("precision", share(940, 1000), False),
            ("heldout", 1.15, True),
            ("heldout", 1.16, False),
            ("triples_f1", 0.85, True),
            ("triples_f1", 0.84, False),
            ("calibration_error", None, False),
            ("pairs", share(0, 0), False),
            ("intervals", share(90, 100), True),
            ("intervals", share(95, 100), False),
            ("intervals", share(85, 100), False),
        ],
    )
    def test_a_goal_is_reached_by_value_and_bound(self, key, value, met):
        assert reached(key, value) is met

    def test_the_bound_quoted_is_the_one_that_does_not_flatter(self):
        assert cell(share(1, 10), "false_alarms") == f"10.0 % (1/10; ≤ {100 * share(1, 10)['at_most']:.1f} %)"
        assert cell(share(9, 10), "precision") == f"90.0 % (9/10; ≥ {100 * share(9, 10)['at_least']:.1f} %)"
