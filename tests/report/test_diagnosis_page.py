"""The page of a diagnosis: self-contained, in the agreed file format, and checked in a browser."""

import dataclasses
import json
import math
import re
import shutil
import subprocess
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.image import imread
from matplotlib.text import Text
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from tests.report.synthetic_diagnosis import NOISE_UM, diagnosis
from torchpi.diagnosis.diagnosis import Diagnosis, Errors, NextRecording, Rival, Trace
from torchpi.diagnosis.locate import locate
from torchpi.diagnosis.say import spoken
from torchpi.report import diagnosis_page
from torchpi.report.diagnosis_events import write_tensorboard
from torchpi.report.diagnosis_figures import diagnosis_figures
from torchpi.report.diagnosis_fit import remains_figure
from torchpi.report.diagnosis_json import diagnosis_json
from torchpi.report.diagnosis_page import write_diagnosis
from torchpi.report.diagnosis_words import headline, in_prose, likelihood, spoken_rivals
from torchpi.report.what_was_run import Provenance

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")


@pytest.fixture(scope="module")
def html(folder: Path) -> str:
    return (folder / "report.html").read_text(encoding="utf-8")


def test_the_page_loads_nothing_external_and_is_small(html: str) -> None:
    assert not re.search(
        r"https?://|src=|@import|<link|<script|<iframe|<object|<img|\bon\w+=", without_scripts(html)
    )
    assert all(
        target.startswith("#") for target in re.findall(r'url\(([^)]*)\)|href="([^"]*)"', html)[0] if target
    )
    assert len(html.encode()) < 2_000_000


def without_scripts(html: str) -> str:
    """Return the page without its scripts; loads by scripts are tested in a browser that forbids them."""
    return re.sub(r"<script[ >].*?</script>", "", html, flags=re.DOTALL)


def test_identifiers_are_unique_and_references_resolve(html: str) -> None:
    ids = re.findall(r'\bid="([^"]+)"', html)
    assert len(ids) == len(set(ids))
    referenced = {a or b for a, b in re.findall(r'href="#([^"]+)"|url\(#([^)]+)\)', html)}
    assert referenced <= set(ids)


def test_the_summary_comes_first_and_the_sections_follow_in_order(html: str, found: Diagnosis) -> None:
    order = [
        'data-verdict="explained"',
        found.says,
        'id="where"',
        'id="what"',
        'id="effect-amplifier_lag"',
        'id="effect-resonance"',
        'id="before-after"',
        'id="remains"',
        'id="next"',
        'id="notes"',
        "What was run",
    ]
    places = [html.index(text) for text in order]
    assert places == sorted(places)
    assert "recording multisine_low" in html


def test_external_text_is_escaped(html: str) -> None:
    assert "&lt;b&gt;.yaml" in html and "&lt;b&gt;load_change&lt;/b&gt;" in html
    assert "<b>.yaml" not in html and "<b>load_change" not in html


def test_numbers_on_the_page_are_those_of_the_diagnosis(html: str, found: Diagnosis) -> None:
    shown = {float(value) for value in re.findall(r'<data value="([^"]+)"', html)}
    promised = [1e3 * errors.heldout_rms_um for errors in (found.nominal, found.retuned, found.augmented)]
    for effect in found.effects:
        promised += [100 * effect.probability, 100 * effect.share]
        for rival in effect.rivals:
            promised += [1e3 * rival.train_rms_um, rival.loses_nats, 100 * rival.probability]
        promised += [
            number for one in effect.parameters if one.interval_90 for number in (one.value, *one.interval_90)
        ]
    assert set(promised) <= shown


def test_the_json_keeps_its_contract(folder: Path, found: Diagnosis) -> None:
    content = json.loads((folder / "diagnosis.json").read_text(encoding="utf-8"), parse_constant=pytest.fail)
    assert content["verdict"] == "explained"
    assert [effect["name"] for effect in content["effects"]] == [
        "amplifier_lag",
        "resonance",
        "hysteresis_operator",
    ]
    for effect in content["effects"]:
        assert set(effect) == {"name", "block", "alternatives", "probability", "parameters", "share"}
        for parameter in effect["parameters"].values():
            assert set(parameter) == {"value", "unit", "interval_90"}
    assert content["effects"][0]["parameters"]["cutoff_hz"] == {
        "value": 412.0,
        "unit": "Hz",
        "interval_90": [398.0, 427.0],
    }
    family = content["effects"][2]["parameters"]["family"]
    assert family == {"value": "preisach", "unit": "", "interval_90": None}
    assert content["open"] == [{"name": "thermal_drift", "alternatives": ["creep"], "probability": 0.23}]
    assert len(content["where"]) == len(found.where)
    assert {cell["domain"] for cell in content["where"]} == {
        "time",
        "frequency",
        "displacement",
        "rate",
        "direction",
        "since_reversal",
        "amplitude",
        "recording",
    }
    assert all({"domain", "range", "unit", "share"} <= set(cell) for cell in content["where"])
    assert set(content["fit"]) == {"nominal", "retuned", "augmented", "noise_floor_um", "heldout"}
    for stage in ("nominal", "retuned", "augmented"):
        assert set(content["fit"][stage]) == {"train_rms_um", "heldout_rms_um", "heldout_max_um"}
    assert set(content["next_recording"]) == {"why", "excitation"}
    (across,) = content["across_recordings"]
    assert set(across) == {"recording", "rms_um", "fitted_rms_um"} and across["rms_um"] == 0.0051
    assert content["another_motion_um"] == 0.0031
    assert content["joint_share"] == 0.0
    assert content["unexplained_share"] == 0.01 and content["says"] == found.says


def test_a_recording_not_predicted_by_the_others_is_in_the_headline_and_the_table(
    found: Diagnosis, html: str, provenance: Provenance
) -> None:
    assert 'data-signal="across"' in html
    missed = dataclasses.replace(found.across[0], rms_um=0.05)
    partly = dataclasses.replace(found, verdict="partly_explained", across=(missed,), carries_over=False)
    assert headline(partly).startswith("Explained for these motions only: held-out error")
    alone = dataclasses.replace(partly, across=(), carries_over=True)
    assert headline(alone).startswith("Partly explained")
    assert 'data-signal="across"' not in diagnosis_page.diagnosis_page(alone, provenance)


def test_the_share_explained_only_jointly_has_its_own_bar(found: Diagnosis) -> None:
    def bars(diagnosis: Diagnosis) -> list[str]:
        return [tick.get_text() for tick in remains_figure(diagnosis).axes[0].get_yticklabels()]

    shared = dataclasses.replace(found, joint_share=0.2)
    names = [spoken(one.name) for one in found.effects]
    assert bars(shared) == [*names, "several together", "unexplained"]
    assert bars(found) == [*names, "unexplained"]


def test_rivals_of_the_same_name_are_distinguished_by_their_form() -> None:
    drifts = [Rival("thermal_drift", 0.01, 3.0, 0.1, form) for form in ("linear", "exponential")]
    creep = Rival("creep", 0.01, 3.0, 0.1, "logarithm")
    assert spoken_rivals([*drifts, creep]) == [
        "thermal drift (linear)",
        "thermal drift (exponential)",
        "creep",
    ]


def test_non_finite_numbers_are_null_in_the_json(found: Diagnosis, provenance: Provenance) -> None:
    broken = dataclasses.replace(
        found, noise_floor_um=math.nan, nominal=Errors(math.inf, np.float64(1.0), np.float32(2.0))
    )
    fit = json.loads(diagnosis_json(broken, provenance))["fit"]
    assert fit["noise_floor_um"] is None
    assert fit["nominal"] == {"train_rms_um": None, "heldout_rms_um": 1.0, "heldout_max_um": 2.0}


def test_figures_are_written_beside_the_page_and_replace_the_old_ones(
    folder: Path, found: Diagnosis, figures: dict[str, Figure], provenance: Provenance, tmp_path: Path
) -> None:
    names = {path.name for path in (folder / "figures").iterdir()}
    assert names == {f"{name}.{kind}" for name in figures for kind in ("png", "svg")}
    for drawn in (folder / "figures").glob("*.svg"):
        assert ElementTree.parse(drawn).getroot().tag == "{http://www.w3.org/2000/svg}svg"
    assert {"where", "errors", "signature_resonance", "rivals_amplifier_lag", "multisine_1"} <= set(figures)
    (tmp_path / "figures").mkdir()
    (tmp_path / "figures" / "signature_creep.png").write_bytes(b"old")
    write_diagnosis(found, provenance, tmp_path, {"errors": figures["errors"]})
    assert {path.name for path in (tmp_path / "figures").iterdir()} == {"errors.png", "errors.svg"}
    kept = {"figures", "report.html", "diagnosis.json", "next_excitation.csv"}
    assert {path.name for path in tmp_path.iterdir()} == kept


def test_a_failed_write_leaves_the_folder_unchanged(
    found: Diagnosis, figures: dict[str, Figure], provenance: Provenance, tmp_path: Path, monkeypatch: Any
) -> None:
    write_diagnosis(found, provenance, tmp_path, {"errors": figures["errors"]})
    before = {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}

    def fails(*_: object) -> None:
        raise OSError("disk full")

    monkeypatch.setattr(diagnosis_page, "write_png", fails)
    with pytest.raises(OSError, match="disk full"):
        write_diagnosis(found, provenance, tmp_path, {"remains": figures["remains"]})
    assert {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()} == before


def test_axes_have_units_and_text_is_eight_points_or_more(figures: dict[str, Figure]) -> None:
    for name, figure in figures.items():
        assert min(text.get_fontsize() for text in figure.findobj(Text) if text.get_text()) >= 8, name
        for axes in figure.axes:
            if axes.get_visible():
                labels = axes.get_xlabel() + axes.get_ylabel()
                assert "(" in labels, (name, labels)


def test_tensorboard_gets_the_same_figures_and_the_numbers(
    found: Diagnosis, figures: dict[str, Figure], provenance: Provenance, tmp_path: Path
) -> None:
    few = {name: figures[name] for name in ("errors", "remains")}
    write_diagnosis(found, provenance, tmp_path, few)
    events = EventAccumulator(str(write_tensorboard(found, tmp_path)))
    events.Reload()
    assert set(events.Tags()["images"]) == set(few)
    assert {"heldout_rms_um/augmented", "share/resonance", "parameter/amplifier_lag.cutoff_hz"} <= set(
        events.Tags()["scalars"]
    )


def _nothing(u: np.ndarray, e: np.ndarray) -> Diagnosis:
    n = len(u)
    trace = Trace("rest", 1_000.0, np.arange(n) / 1_000, u, 0.8 * u + e, np.zeros(n, bool), e, e)
    same = Errors(float(e.std()), float(e.std()), float(np.abs(e).max()))
    return dataclasses.replace(
        diagnosis(),
        verdict="nothing_missing",
        effects=(),
        where=locate((trace,), 0.0),
        nominal=same,
        retuned=same,
        augmented=same,
        noise_floor_um=0.0,
        unexplained_share=0.0,
        notes=(),
        traces=(trace,),
        next_recording=NextRecording("Nothing is open.", "none"),
        says="Nothing is missing.",
        next_excitation=(np.zeros(0), np.zeros(0)),
    )


def test_a_hold_without_any_residual_still_gives_a_page(provenance: Provenance, tmp_path: Path) -> None:
    page, numbers = write_diagnosis(_nothing(np.full(300, 3.0), np.zeros(300)), provenance, tmp_path)
    assert "Nothing is missing" in page.read_text(encoding="utf-8")
    json.loads(numbers.read_text(encoding="utf-8"), parse_constant=pytest.fail)


@pytest.fixture(scope="module")
def unmeasured(found: Diagnosis) -> Diagnosis:
    return dataclasses.replace(found, where=locate(found.traces, 0.0), noise_floor_um=None)


def test_an_unmeasured_noise_is_stated_and_left_out_of_comparisons(
    unmeasured: Diagnosis, provenance: Provenance, tmp_path: Path
) -> None:
    drawn = diagnosis_figures(unmeasured)
    page, numbers = write_diagnosis(unmeasured, provenance, tmp_path, drawn)
    html = page.read_text(encoding="utf-8")
    assert "noise not measured" in html and "The noise was not measured." in html
    assert "is not known how much of the remaining error is unexplained" in html
    half = dataclasses.replace(unmeasured, verdict="partly_explained")
    assert headline(half).startswith("Partly explained: held-out error")
    assert "times the noise" not in html and "held out over the noise" not in html and " ×</td>" not in html
    assert json.loads(numbers.read_text(encoding="utf-8"))["fit"]["noise_floor_um"] is None
    for name in ("errors", "heldout", "spectrum"):
        labels = [line.get_label() for axes in drawn[name].axes for line in axes.lines]
        assert not any("noise" in str(label) for label in labels), name
    write_tensorboard(unmeasured, tmp_path)
    events = EventAccumulator(str(tmp_path / "tensorboard")).Reload()
    assert "noise_floor_um" not in events.Tags()["scalars"]


def test_the_page_begins_with_the_verdict_and_its_number(html: str, found: Diagnosis) -> None:
    error, times = 1e3 * found.augmented.heldout_rms_um, found.augmented.heldout_rms_um / NOISE_UM
    expected = f"Explained: held-out error {error:.3g} nm, {times:.2f} times the noise"
    assert html.index(expected) < html.index("<svg")
    for verdict, start in (
        ("nothing_missing", "Nothing is missing: held-out error "),
        ("partly_explained", "Partly explained: 1 % of the squared mismatch is not; held-out error "),
        ("unexplained", "Something is missing that no known effect explains: held-out error "),
    ):
        assert headline(dataclasses.replace(found, verdict=verdict)).startswith(start)


def test_the_wording_follows_the_probability(html: str) -> None:
    text = re.sub(r"<[^>]+>", "", html)
    assert "It is missing (probability 93 %)" in text
    assert "It may be missing (probability 42 %)" in text
    assert [likelihood(p) for p in (0.95, 0.7, 0.3)] == ["missing", "probably missing", "may be missing"]


def test_prose_has_no_identifiers_and_dimensionless_values_have_no_unit(html: str, found: Diagnosis) -> None:
    page = html[html.index("<h1>") : html.index("What was run")]
    text = re.sub(r'<(style|svg)\b.*?</\1>|<p class="equation">.*?</p>|<[^>]+>', " ", page, flags=re.DOTALL)
    names = {trace.name for trace in found.traces} | {"next_excitation"}  # the name of a file
    quoted = {"load_change"}  # in an external note, which is not our prose
    assert set(re.findall(r"\b[a-z]\w*_\w+", text)) - names - quoted == set()
    assert in_prose("load_change: left out, as thermal_drift.") == "load change: left out, as thermal drift."
    assert "<td>1</td>" not in html and "damping ratio" in html


def test_an_effect_without_rivals_still_gives_a_page(
    found: Diagnosis, provenance: Provenance, tmp_path: Path
) -> None:
    lonely = tuple(dataclasses.replace(effect, rivals=()) for effect in found.effects)
    alone = dataclasses.replace(found, effects=lonely)
    drawn = diagnosis_figures(alone)
    assert not any(name.startswith("rivals_") for name in drawn)
    page, _ = write_diagnosis(alone, provenance, tmp_path, drawn)
    assert all(effect.name.replace("_", " ") in page.read_text() for effect in alone.effects)


def look(html: str, folder: Path) -> tuple[str, str, Path]:
    """Return the page's DOM, the browser's console messages, and a screenshot.

    The page is given a policy that forbids every load, so that the console reports each attempt.
    """
    policy = "default-src 'none'; style-src 'unsafe-inline'; script-src 'unsafe-inline'"
    page, shot = folder / "page.html", folder / "page.png"
    head = f'<head><meta http-equiv="Content-Security-Policy" content="{policy}">'
    page.write_text(html.replace("<head>", head, 1), encoding="utf-8")
    command = [
        str(CHROMIUM),
        "--headless",
        "--no-sandbox",
        "--disable-gpu",
        "--hide-scrollbars",
        "--enable-logging=stderr",
        "--window-size=1050,3000",
        "--disable-background-networking",
        "--disable-component-update",
        "--no-first-run",
        f"--user-data-dir={folder / 'profile'}",
        f"--screenshot={shot}",
        "--dump-dom",
        page.as_uri(),
    ]
    done = subprocess.run(command, capture_output=True, timeout=120, check=True)
    console = [line for line in done.stderr.decode(errors="replace").splitlines() if "CONSOLE" in line]
    return done.stdout.decode(), "\n".join(console), shot


@pytest.mark.skipif(CHROMIUM is None, reason="needs chromium: apt install chromium")
def test_a_browser_shows_the_page_without_errors(html: str, folder: Path, tmp_path: Path) -> None:
    dom, complaints, shot = look(html, tmp_path)
    assert complaints == ""
    assert dom.count('class="figure"') == len(list((folder / "figures").glob("*.svg")))
    picture = imread(shot)
    assert picture.shape[:2] == (3_000, 1_050)
    # There is ink over the whole height of the screenshot, with no blank stretch of 300 pixels.
    inked = np.flatnonzero((picture[..., :3].mean(-1) < 0.9).any(1))
    assert inked[0] < 100 and np.diff(inked).max() < 300


@pytest.mark.skipif(CHROMIUM is None, reason="needs chromium: apt install chromium")
def test_a_browser_reports_an_attempt_to_load_something(tmp_path: Path) -> None:
    html = '<!DOCTYPE html><html><head></head><body><img src="http://example.invalid/a.png"></body></html>'
    assert "example.invalid" in look(html, tmp_path)[1]
