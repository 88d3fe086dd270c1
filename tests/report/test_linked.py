"""Linked traces keep peaks, show values under the pointer and zoom together; the pages fit their screens."""

import json
import re
import shutil
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from markupsafe import Markup

from torchpi.loop.result import LoopResult
from torchpi.report import page
from torchpi.report.linked import MOST_NUMBERS, Curve, Linked, Panel, linked_markup

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
LOOK = {"color": "#0072B2", "linewidth": 1.0}
SCREENS = {"screen": (1200, 800), "narrow": (400, 800)}

# Measures from inside the page: its width, the end of its first picture, the values under the pointer.
PROBE = """
<script>
const wait = (ms) => new Promise((done) => setTimeout(done, ms));
const values = (live) => [...live.querySelectorAll(".u-legend")].map((legend) =>
  [...legend.querySelectorAll(".u-value")].map((one) => one.textContent));
function point(over, share) {
  const box = over.getBoundingClientRect();
  over.dispatchEvent(new MouseEvent("mousemove",
    { clientX: box.left + share * box.width, clientY: box.top + box.height / 2, bubbles: true }));
}
addEventListener("load", async () => {
  const said = { name: window.name, scrolls: document.documentElement.scrollWidth - innerWidth };
  const pictures = [...document.querySelector("figure").querySelectorAll(".uplot, svg.figure")];
  said.ends = Math.max(...pictures.map((one) => one.getBoundingClientRect().bottom));
  said.number = document.querySelector(".answer strong").getBoundingClientRect().bottom;
  const live = document.querySelector(".live");
  if (live) {
    const over = live.querySelector(".u-over");
    await wait(50);
    point(over, 0.5); await wait(50);
    said.middle = values(live);
    point(over, 0.001); await wait(50);
    said.start = values(live);
    live.querySelector("button").click(); await wait(50);
    point(over, 0.001); await wait(50);
    said.zoomed = values(live);
  }
  parent.postMessage(JSON.stringify(said), "*");
});
</script>
"""


def shown_by(html: str, folder: Path, *options: str) -> dict[str, dict[str, Any]]:
    """Return what the page measures in a browser on each screen, whose console must stay silent."""
    (folder / "page.html").write_text(html.replace("</body>", PROBE + "</body>"), encoding="utf-8")
    frames = "".join(
        f'<iframe name="{name}" src="page.html" width="{w}" height="{h}" style="border:0"></iframe>'
        for name, (w, h) in SCREENS.items()
    )
    heard = (
        "onmessage = (e) => { const out = document.createElement('pre');"
        " out.textContent = e.data; document.body.append(out); }"
    )
    (folder / "frames.html").write_text(f"<body><script>{heard}</script>{frames}</body>", encoding="utf-8")
    command = [
        str(CHROMIUM),
        "--headless",
        "--no-sandbox",
        "--disable-gpu",
        "--enable-logging=stderr",
        "--hide-scrollbars",
        "--window-size=1700,900",
        "--disable-background-networking",
        "--no-first-run",
        "--disable-component-update",
        f"--user-data-dir={folder / 'profile'}",
        *options,
        "--virtual-time-budget=5000",
        "--dump-dom",
        (folder / "frames.html").as_uri(),
    ]
    done = subprocess.run(command, capture_output=True, timeout=120, check=True)
    assert "CONSOLE" not in done.stderr.decode(errors="replace"), done.stderr.decode(errors="replace")
    said = [json.loads(text) for text in re.findall(r"<pre>({.*?})</pre>", done.stdout.decode())]
    assert {one["name"] for one in said} == set(SCREENS)
    return {one["name"]: one for one in said}


TRACED = ("loop", "training", "diagnosis", "commission", "check", "paper")
"""Pages with zoomable traces."""


@pytest.fixture(scope="module")
def pages(request: pytest.FixtureRequest, folder: Path) -> dict[str, str]:
    diagnosed = (folder / "report.html").read_text(encoding="utf-8")
    others = (name for name in (*TRACED, "safety") if name != "diagnosis")
    return {"diagnosis": diagnosed} | {name: request.getfixturevalue(f"{name}_html") for name in others}


def data_in(markup: str) -> list[dict[str, Any]]:
    return [json.loads(text) for text in re.findall(r'class="linked-data">(.*?)</script>', markup, re.DOTALL)]


def test_thinning_keeps_a_peak_of_one_sample_with_its_time_and_neighbouring_curve() -> None:
    t = np.arange(200_000) / 1e4
    quiet, peaked = np.sin(t), 1e-3 * np.cos(40 * t)
    peaked[123_456] = 7.5
    panels = (
        Panel("displacement", "µm", (Curve("a", quiet, LOOK),)),
        Panel("error", "nm", (Curve("b", peaked, LOOK),)),
    )
    (data,) = data_in(linked_markup([Linked(t, panels)], Markup("<svg></svg>"), 10_000))
    first, second = (panel["curves"][0]["values"] for panel in data["panels"])
    at = second.index(max(second))
    assert len(data["t"]) == len(first) == len(second) < 3_400
    assert (data["t"][at], second[at]) == (12.3456, 7.5)
    assert first[at] == pytest.approx(quiet[123_456], abs=1e-4)
    assert f"{len(data['t']):,} of 200,000 samples" in data["note"]


def test_an_external_name_cannot_end_the_script() -> None:
    t = np.arange(10.0)
    curve = Curve("</script><b>", t, LOOK)
    markup = linked_markup([Linked(t, (Panel("y", "µm", (curve,)),))], Markup(""))
    assert markup.count("</script>") == 1
    assert data_in(markup)[0]["panels"][0]["curves"][0]["label"] == "</script><b>"


def test_the_initial_view_is_sampled_more_densely_than_the_whole() -> None:
    t = np.arange(200_000) / 1e4
    linked = Linked(t, (Panel("y", "µm", (Curve("a", np.sin(99 * t), LOOK),)),), view=(10.0, 10.2))
    (data,) = data_in(linked_markup([linked], Markup(""), 10_000))
    assert data["view"] == [10.0, 10.2] and "Shown first: 0.2 s of 20 s" in data["note"]
    assert sum(10.0 <= one <= 10.2 for one in data["t"]) > 500 > 0.2 * len(data["t"]) / 20


def test_a_short_constant_record_has_traces() -> None:
    t = np.arange(3.0)
    linked = Linked(t, (Panel("y", "µm", (Curve("a", np.zeros(3), LOOK),)),))
    assert data_in(linked_markup([linked], Markup("")))[0]["t"] == [0.0, 1.0, 2.0]


@pytest.mark.parametrize("name", TRACED)
def test_a_page_is_below_two_megabytes_and_forbids_every_load(name: str, pages: dict[str, str]) -> None:
    html = pages[name]
    assert len(html.encode()) < 2_000_000
    assert "default-src 'none'" in html.partition("<style>")[0]
    numbers = sum(
        len(one["t"]) * (1 + sum(len(panel["curves"]) for panel in one["panels"])) for one in data_in(html)
    )
    assert 5_000 < numbers <= MOST_NUMBERS
    assert "Permission is hereby granted" in html  # uPlot's licence must accompany its code


@pytest.mark.skipif(CHROMIUM is None, reason="needs chromium: apt install chromium")
@pytest.mark.parametrize("name", [*TRACED, "safety"])
def test_the_first_screen_shows_number_and_picture_and_values_follow_the_pointer(
    name: str, pages: dict[str, str], tmp_path: Path
) -> None:
    shown = shown_by(pages[name], tmp_path)
    assert max(shown["screen"]["number"], shown["screen"]["ends"]) <= 800
    for one in shown.values():
        assert one["scrolls"] <= 0
        if name == "safety":
            continue
        for values in (one["middle"], one["start"], one["zoomed"]):
            times = {panel[0] for panel in values}
            assert len(times) == 1 and "–" not in times  # the panels share the pointer
        start, middle, zoomed = (
            float(one[part][0][0].removesuffix(" s")) for part in ("start", "middle", "zoomed")
        )
        assert start < zoomed < middle
        units = {value.rpartition(" ")[2] for panel in one["middle"] for value in panel} - {"–"}
        assert {"s", "µm"} <= units and units & {"nm", "mV", "V", "µm"}


@pytest.mark.skipif(CHROMIUM is None, reason="needs chromium: apt install chromium")
def test_values_under_the_pointer_are_those_of_the_record(
    pages: dict[str, str], results: list[LoopResult], tmp_path: Path
) -> None:
    shown = shown_by(pages["loop"], tmp_path, "--blink-settings=preferredColorScheme=0")["screen"]["middle"]
    result = results[0]
    k = round(float(shown[0][0].removesuffix(" s")) * result.fs_hz)
    without, ours, reference = (float(text.removesuffix(" µm")) for text in shown[0][1:])
    assert reference == pytest.approx(result.yd[k], abs=1e-3)
    assert ours == pytest.approx(result.compensated.y_true[k], abs=1e-3)
    error_nm = float(shown[1][-1].removesuffix(" nm").replace("−", "-"))
    assert error_nm == pytest.approx(1e3 * (result.compensated.y_true[k] - result.yd[k]), abs=0.1)
    assert without == pytest.approx(result.drives["without"].y_true[k], abs=1e-3)


def test_dark_mode_colours_are_the_same_in_scripts_and_figures(pages: dict[str, str]) -> None:
    style = pages["loop"].partition("<style>")[2].partition("</style>")[0]
    assert "svg.figure, .live canvas, .live .u-marker { filter:" in style
    overridden = re.findall(r"--([0-9a-f]{6}):", style)  # read by the script; the figures have rules
    assert overridden == ["e69f00", "d55e00"]
    for color in overridden:
        for what in ("stroke", "fill"):
            rule = f'svg.figure [style*="{what}: #{color}"] {{ {what}: var(--{color}) !important; }}'
            assert rule in style


def test_without_scripts_the_static_figure_is_shown(pages: dict[str, str]) -> None:
    for name, html in pages.items():
        style = html.partition("<style>")[2].partition("</style>")[0]
        assert ".live { display: none; }" in style  # and only a script changes that
        stills, linked = (
            html.count('<div class="still"><svg class="figure"'),
            html.count('<div class="linked">'),
        )
        assert stills == linked and bool(linked) == (name in TRACED)


def test_elements_that_scroll_on_a_screen_are_printed_in_full() -> None:
    """A printed scrollbar would cover the numbers."""
    style = (Path(page.__file__).parent / "templates" / "base.html.j2").read_text(encoding="utf-8")
    paper = style[style.index("@media print") :]
    scrolled = set(re.findall(r"^([\w.]+) {[^}]*overflow-x: auto", style, re.MULTILINE))
    assert scrolled == {".wide", "figure"}
    shown = re.search(r"([\w., ]+) { overflow: visible; }", paper)
    assert shown and set(shown[1].strip().split(", ")) == scrolled
