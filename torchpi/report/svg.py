"""Figures as SVG that can be embedded in an HTML page beside others."""

import io
import re

from matplotlib.figure import Figure

from torchpi.report.style import WIDTH_IN, drawing


def inline_svg(figure: Figure, name: str, describes: str) -> str:
    """Return the figure's <svg> element, the same bytes for the same figure.

    Args:
        figure: the figure.
        name: unique on the page; keeps the figure's identifiers apart from other figures'.
        describes: description for readers who cannot see the figure.
    """
    buffer = io.StringIO()
    with drawing():
        figure.savefig(
            buffer, format="svg", metadata={"Date": None, "Creator": None, "Format": None, "Type": None}
        )
    text = buffer.getvalue()
    text = text[text.index("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>", "", text, flags=re.DOTALL)
    text = re.sub(r"<!--.*?-->", "", text, flags=re.DOTALL)
    # In HTML, inline SVG needs no namespaces, and `href` needs no prefix.
    text = re.sub(r'\sxmlns(:\w+)?="[^"]*"', "", text).replace("xlink:href=", "href=")
    text = _renamed(text, name)
    text = re.sub(r'<path [^>]*?\bd="[^"]*"', _shorter_numbers, text, flags=re.DOTALL)
    width, height = re.search(r'viewBox="0 0 (\S+) (\S+)"', text).groups()  # type: ignore[union-attr]
    share = min(1.0, float(width) / (72.0 * WIDTH_IN))
    head = (
        f'<svg class="figure" style="width: {100 * share:.3g}%; --share: {share:.3g}" '
        f'viewBox="0 0 {width} {height}" '
        f'role="img" aria-label="{_escaped(describes)}">'
    )
    return head + re.sub(r"\n\s*", "\n", text[text.index(">") + 1 :]).strip()


def _renamed(text: str, name: str) -> str:
    """Number identifiers in order, because matplotlib derives some of them from memory addresses."""
    referenced = set(re.findall(r'href="#([^"]+)"|url\(#([^)]+)\)', text))
    wanted = {first or second for first, second in referenced}
    found = [old for old in re.findall(r'\bid="([^"]*)"', text) if old in wanted]
    new = {old: f"{name}-{number}" for number, old in enumerate(dict.fromkeys(found))}
    text = re.sub(r'\s*\bid="([^"]*)"', lambda m: f' id="{new[m[1]]}"' if m[1] in new else "", text)
    text = re.sub(r'href="#([^"]*)"', lambda m: f'href="#{new[m[1]]}"', text)
    return re.sub(r"url\(#([^)]*)\)", lambda m: f"url(#{new[m[1]]})", text)


def _shorter_numbers(match: re.Match[str]) -> str:
    """Round numbers to a hundredth of a point, which is finer than any print."""
    return re.sub(r"-?\d+\.\d{3,}", lambda number: f"{float(number[0]):.2f}", match[0])


def _escaped(text: str) -> str:
    return text.replace("&", "&amp;").replace('"', "&quot;").replace("<", "&lt;")
