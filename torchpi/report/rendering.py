"""Rendering of page templates, strict about undefined values, and the script of the linked traces."""

from functools import cache
from pathlib import Path
from typing import Any

import jinja2
from markupsafe import Markup

FOLDER = Path(__file__).parent


def environment(**filters: Any) -> jinja2.Environment:
    """Return the environment in which all templates are read, with the filters of a page."""
    made = jinja2.Environment(
        loader=jinja2.PackageLoader("torchpi.report"),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    made.filters.update(filters)
    made.globals["linked_traces"] = _linked_traces
    return made


@cache
def _linked_traces() -> Markup:
    """Return styles and scripts that draw the data from `linked.py`, with uPlot's licence."""
    uplot = FOLDER / "uplot"
    licence = (uplot / "LICENSE").read_text(encoding="utf-8").strip()
    parts = [
        f"<style>{(uplot / 'uPlot.min.css').read_text(encoding='utf-8')}</style>",
        f"<script>/*\n{licence}\n*/\n{(uplot / 'uPlot.iife.min.js').read_text(encoding='utf-8')}</script>",
        f"<script>{(FOLDER / 'linked.js').read_text(encoding='utf-8')}</script>",
    ]
    return Markup("\n".join(parts))
