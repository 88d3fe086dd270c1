"""The documentation: every public name is on the API page, every link leads somewhere, the examples run."""

import ast
import importlib
import inspect
import pkgutil
import re
import sys
import warnings
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

import torchpi
from docs.executed import EXECUTED, with_outputs

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
PAGES = sorted(
    [
        *DOCS.glob("*.md"),
        *ROOT.glob("*.md"),
        ROOT / "exports" / "README.md",
        *ROOT.glob("benchmarks/**/README.md"),
    ]
)
INTERNAL = ("torchpi.report", "torchpi.recordings.readers")  # internal to commands and recordings
COMPLETE = ["torchpi"] + [
    name
    for _, name, is_package in pkgutil.walk_packages(torchpi.__path__, "torchpi.")
    if is_package and name not in INTERNAL and hasattr(importlib.import_module(name), "__all__")
]
LINK = re.compile(r"\]\((?!https?://)([^)#\s]*)(?:#([^)\s]+))?\)")


def text_of(page: Path) -> str:
    return page.read_text(encoding="utf-8")


def python_of(page: Path) -> list[str]:
    """Return the Python blocks of a page."""
    return re.findall(r"^```python\n(.*?)^```", text_of(page), re.DOTALL | re.MULTILINE)


def documented() -> dict[str, Any]:
    """Return the objects that the tables of the API page list, by full name."""
    found = {}
    for block in re.findall(r"```{eval-rst}\n(.*?)```", text_of(DOCS / "api.md"), re.DOTALL):
        (module,) = re.findall(r"^\.\. currentmodule:: (\S+)$", block, re.MULTILINE)
        for name in re.findall(r"^   ([A-Za-z][\w.]*)$", block, re.MULTILINE):
            found[f"{module}.{name}"] = named(f"{module}.{name}")
    return found


def named(full_name: str) -> Any:
    """Return an object by its module and name; a function may have the name of its module."""
    module, _, name = full_name.rpartition(".")
    return getattr(importlib.import_module(module), name)


def without_code(text: str) -> str:
    """Remove code and equations, so that only text with links remains."""
    return re.sub(r"^```.*?^```|`[^`\n]*`|\$[^$\n]*\$", "", text, flags=re.DOTALL | re.MULTILINE)


def anchors(page: Path) -> set[str]:
    """Return the anchors of a page's headings, as code hosts and MyST make them."""
    text = re.sub(r"^```.*?^```", "", text_of(page), flags=re.DOTALL | re.MULTILINE)
    headings = re.findall(r"^#{1,3} (.+)$", text, re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


@pytest.mark.parametrize("name", COMPLETE)
def test_every_public_name_is_on_the_api_page(name: str) -> None:
    module: ModuleType = importlib.import_module(name)
    listed, text = [id(value) for value in documented().values()], text_of(DOCS / "api.md")
    missing = [
        public
        for public in module.__all__
        if id(getattr(module, public)) not in listed
        and f"`{public}`" not in text
        and f"`{name}.{public}`" not in text
    ]
    assert missing == []


def test_every_name_on_the_api_page_exists_and_is_listed_once() -> None:
    found = documented()
    assert len(found) > 80
    assert len({id(value) for value in found.values()}) == len(found)


def test_every_public_name_has_an_example() -> None:
    """In its docstring, or in a block of the examples page that imports it, which the site then shows."""
    used: list[int] = []
    for block in python_of(DOCS / "examples.md"):
        tree = ast.parse(block)
        loaded = {node.id for node in ast.walk(tree) if isinstance(node, ast.Name)}
        for node in ast.walk(tree):
            if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("torchpi"):
                names = [alias.name for alias in node.names if alias.name in loaded]
                used += [id(named(f"{node.module}.{name}")) for name in names]
    missing = [
        name
        for name, value in documented().items()
        if id(value) not in used and ">>>" not in (inspect.getdoc(value) or "")
    ]
    assert missing == []


def test_the_examples_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [*sys.path])  # a user-defined simulation is imported from here
    names: dict[str, Any] = {}
    with warnings.catch_warnings():
        for block in re.findall(
            r"^```python\n(.*?)^```", text_of(DOCS / "examples.md"), re.DOTALL | re.MULTILINE
        ):
            exec(block, names)


def test_every_documented_name_has_a_docstring() -> None:
    assert [name for name, value in documented().items() if not (value.__doc__ or "").strip()] == []


def test_no_summary_on_the_api_page_ends_at_an_abbreviation() -> None:
    """The site's tables show the text before the first full stop that is followed by a space."""
    summaries = {name: " ".join((value.__doc__ or "").split()) for name, value in documented().items()}
    assert [name for name, text in summaries.items() if re.match(r"[^.]*\b(eqs?|Figs?|cf)\. ", text)] == []


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_every_link_leads_to_an_existing_file_and_heading(page: Path) -> None:
    broken = []
    for path, anchor in LINK.findall(without_code(text_of(page))):
        target = page.parent / path if path else page
        if not target.exists() or (anchor and anchor not in anchors(target)):
            broken.append(f"{path}#{anchor}")
    assert broken == []


def test_every_page_is_linked_from_the_index_and_in_its_contents() -> None:
    text = text_of(DOCS / "index.md")
    contents = re.findall(r"^```{toctree}\n(.*?)```", text, re.DOTALL | re.MULTILINE)
    entries = {
        entry.partition("<")[2].rstrip(">") or entry
        for block in contents
        for entry in block.splitlines()
        if entry and not entry.startswith(":")
    }
    on_site = {page for page in PAGES if page != DOCS / "index.md"}
    assert {(DOCS / f"{entry}.md").resolve() for entry in entries} == on_site
    assert {(DOCS / path).resolve() for path, _ in LINK.findall(text) if path.endswith(".md")} == on_site


@pytest.mark.parametrize("page", ["mismatch.md", "csv_to_controller.md"])
def test_the_commands_of_a_tutorial_are_those_of_the_readme(page: str) -> None:
    def commands(page: Path) -> list[str]:
        """Ignore the lengths of recordings: those of a tutorial make it take less than two minutes."""
        return [
            re.sub(r" --duration_s \S+", "", line)
            for block in re.findall(r"```sh\n(.*?)```", text_of(page), re.DOTALL)
            for line in block.splitlines()
        ]

    tutorial = commands(DOCS / page)
    assert len(tutorial) >= 7
    assert [line for line in tutorial if line not in commands(ROOT / "README.md")] == []


def test_the_programs_of_the_csv_tutorial_are_those_of_the_readme() -> None:
    programs = python_of(DOCS / "csv_to_controller.md")
    assert programs and set(programs) <= set(python_of(ROOT / "README.md"))


def test_an_executed_page_shows_the_values_of_its_expressions() -> None:
    page = "a\n\n```python\nx = 2\nx * 3  # six\n\ny = x\nNone\n```\n\n```python\ny\n```\nb\n"
    assert with_outputs(page) == (
        "a\n\n```python\nx = 2\nx * 3  # six\n```\n```text\n6\n```\n```python\ny = x\nNone\n```\n\n"
        "```python\ny\n```\n```text\n2\n```\nb\n"
    )
    with pytest.raises(ZeroDivisionError):
        with_outputs("```python\n1 / 0\n```\n")
    assert all((ROOT / f"{name}.md").is_file() for name in EXECUTED)


class TestSite:
    """Functions of the Sphinx configuration; `make docs` builds the site, with warnings as errors."""

    @pytest.fixture
    def conf(self, monkeypatch: pytest.MonkeyPatch) -> ModuleType:
        for package in ("sphinx", "myst_parser", "furo"):
            pytest.importorskip(package, reason="sphinx is not installed: pip install 'torchpi[docs]'")
        monkeypatch.syspath_prepend(str(DOCS))
        return importlib.import_module("conf")

    def test_docstring_equations_become_literal_blocks_and_sections_are_unchanged(
        self, conf: ModuleType
    ) -> None:
        found = conf.as_text(["u = |x_|, `x_`", "", "    y = |x|", "      + b", "", "Args:", "    x: |x_|."])
        assert found == [
            "u = \\|x\\_\\|, `x_`",
            "",
            "::",
            "",
            "    y = |x|",
            "      + b",
            "",
            "Args:",
            "    x: \\|x\\_\\|.",
        ]

    def test_every_equation_of_the_theory_becomes_mathml(self, conf: ModuleType) -> None:
        text = text_of(DOCS / "theory.md")
        blocks = re.findall(r"```math\n(.*?)\n```", text, re.DOTALL)
        inline = re.findall(r"\$([^$\n]+)\$", text)
        assert len(blocks) >= 10 and len(inline) >= 20
        for equation in [*blocks, *inline]:
            found = conf.mathml(equation)
            assert found.startswith("<math")
            # A dotted letter has its index beside it.
            assert not re.search(r"<munderover>((?!</munderover>).)*[˙¨]", found, re.DOTALL), equation
