"""Configuration of the documentation site: `make docs` builds it into docs/_build/html."""

import ast
import importlib
import re
import sys
from pathlib import Path
from typing import Any

import numpy.typing as npt
from docutils import nodes
from docutils.utils.math.latex2mathml import tex2mathml
from sphinx import addnodes
from sphinx.application import Sphinx
from sphinx.pycode import ModuleAnalyzer
from sphinx.util.typing import stringify_annotation

import torchpi

sys.path.insert(0, str(Path(__file__).parent))
from described import beside, docstring_of, is_record, with_parameters
from executed import EXECUTED, with_outputs

project = "torchpi"
author = "torchpi developers"
copyright = "torchpi developers"
version = release = torchpi.__version__

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.napoleon",
    "sphinx.ext.viewcode",
]
root_doc = "docs/index"
# The source folder is the checkout: pages link to each other across folders, and to files, as on a code host.
include_patterns = [
    "docs/**",
    "README.md",
    "CHANGELOG.md",
    "CONTRIBUTING.md",
    "exports/README.md",
    "benchmarks/README.md",
    "benchmarks/**/README.md",
]
exclude_patterns = [".*", "docs/_build", "docs/_templates", "runs", "dist", "build"]
nitpicky = True  # a name that leads nowhere is a warning, which is an error
nitpick_ignore_regex = [
    (r"py:.*", r"(torch|numpy|collections|pathlib|concurrent)\..*"),  # of others
    # What is passed on and never made: streams, protocols that a class of one's own meets, unions.
    (r"py:class", r"torchpi\.[\w.]+\.\w*Stream"),
    (r"py:class", r"torchpi\.(loop\.loop\.(Compensator|Plant)|export\.deployable\.Deployable)"),
    (r"py:class", r"torchpi\.(loop\.result\.Ratios|report\.notebook\.Plot|identification\.selection\.Form)"),
    (
        r"py:class",
        r"torchpi\.(operators\.(quantity\.Quantity|dead_zone\.DeadZones"
        r"|modal_feedback\.(Constants|Parameters))"
        r"|control\.trained_motions\.Pair)",
    ),
    (r"py:class", r"torchpi\.operators\.(generalised_play\.Generalised|oversampled_inputs\.Over)\w+"),
    (r"py:class", r"torchpi\.stage\.effects\.(sensor|mechanics)\.\w+\.\w+"),
]
templates_path = [str(Path(__file__).parent / "_templates")]

myst_enable_extensions = ["dollarmath"]
myst_fence_as_directive = ["math"]  # code hosts draw such a block as an equation, and keep its backslashes
myst_heading_anchors = 3  # links to headings, as GitHub makes them

autosummary_generate = True
napoleon_use_ivar = True  # fields of `Attributes:` that are members as well stand once
autodoc_default_options = {
    "members": True,
    "undoc-members": True,
    "member-order": "bysource",
    "exclude-members": "extra_repr",  # of torch, for its own printing
}
autodoc_preserve_defaults = True
python_maximum_signature_line_length = 90
default_role = "code"  # docstrings quote code between single backticks
highlight_language = "none"

html_theme = "furo"
html_title = f"torchpi {release}"
html_show_copyright = False
html_math_renderer = "mathml"
html_static_path = ["_static"]
html_css_files = ["math.css", "output.css"]
html_additional_pages = {"index": "to_first_page.html"}


_SECTION = re.compile(r"(Args|Attributes|Raises|Returns|Example|Examples):$")
# Absolute values, and what ends in an underscore; not between backticks.
_MARKUP = re.compile(r"(`[^`]*`)|\||(?<=\w)_(?!\w)")
# What docutils makes of \dot y_d, with the index below the letter.
_DOTTED = re.compile(
    r"<munderover>(\s*<mi>.*?</mi>)(\s*<mi>.*?</mi>)(\s*<mo stretchy=\"false\">[˙¨]</mo>)\s*</munderover>"
)
_ARRAY_LIKE = stringify_annotation(npt.ArrayLike, "smart")  # a union of many lines


def as_text(lines: list[str]) -> list[str]:
    """A docstring with its equations, the indented paragraphs, as literal blocks, and nothing else as markup.

    Sections such as `Args:` are left to napoleon: their indented lines follow without an empty line.
    """
    out: list[str] = []
    literal = in_sections = False
    for line in lines:
        in_sections = in_sections or _SECTION.match(line) is not None
        if line.startswith("    "):
            if not (literal or in_sections) and out and not out[-1].strip():
                out += ["::", ""]
                literal = True
        elif line.strip():
            literal = False
        out.append(line if literal else _MARKUP.sub(lambda found: found[1] or f"\\{found[0]}", line))
    return out


def describe(app: Sphinx, what: str, name: str, obj: Any, options: object, lines: list[str]) -> None:
    """Parameters, as the comments beside them and the classes above describe them; fields likewise."""
    if what == "class" and is_record(obj):
        texts_of_fields = ModuleAnalyzer.for_module(obj.__module__).attr_docs
        for field, text in beside(obj).items():
            texts_of_fields.setdefault((obj.__qualname__, field), [text, ""])
    elif what in ("function", "method", "class"):
        own = docstring_of(obj) or "\n".join(lines)  # what is inherited
        lines[:] = [*with_parameters(obj, own).splitlines(), ""]


def prepare_docstring(
    app: Sphinx, what: str, name: str, obj: object, options: object, lines: list[str]
) -> None:
    lines[:] = as_text(lines)
    if what in ("attribute", "property") and lines and ": " in lines[0]:
        lines.insert(0, "\\ ")  # napoleon would take what stands before the colon for a type


def shorten_signature(
    app: Sphinx,
    what: str,
    name: str,
    obj: object,
    options: object,
    signature: str | None,
    returns: str | None,
) -> tuple[str | None, str | None]:
    """numpy's ArrayLike by its name, not as the union that it is; a default that is made anew as `...`."""
    if signature is not None:
        signature = signature.replace(_ARRAY_LIKE, "~numpy.typing.ArrayLike").replace("<factory>", "...")
    return signature, returns


def examples(page: str) -> list[tuple[str, list[object]]]:
    """Each block of Python of a page, with what it imports and uses."""
    found = []
    for block in re.findall(r"^```python\n(.*?)^```", page, re.DOTALL | re.MULTILINE):
        tree = ast.parse(block)
        used = {node.id for node in ast.walk(tree) if isinstance(node, ast.Name)}
        names = [
            (node.module or "", alias.name)
            for node in ast.walk(tree)
            if isinstance(node, ast.ImportFrom)
            for alias in node.names
            if alias.name in used
        ]
        objects = [getattr(importlib.import_module(module), name) for module, name in names]
        found.append((block, objects))
    return found


EXAMPLES = examples((Path(__file__).parent / "examples.md").read_text(encoding="utf-8"))


def show_example(app: Sphinx, what: str, name: str, obj: object, options: object, lines: list[str]) -> None:
    """The block of `examples.md` that a name stands in, where its page has no example of its own."""
    members = vars(obj).values() if what == "class" else []
    if any(">>>" in (getattr(one, "__doc__", None) or "") for one in (obj, *members)):
        return
    for block, objects in EXAMPLES:
        if any(one is obj for one in objects) and what in ("class", "function", "exception"):
            lines += ["", ".. rubric:: Example", "", ".. code-block:: python", ""]
            lines += [f"    {line}" if line else "" for line in block.splitlines()]
            lines += ["", "From :doc:`/docs/examples`, whose blocks before this one make what it uses.", ""]
            return


def execute(app: Sphinx, page: str, source: list[str]) -> None:
    """A program that fails ends the build, if pages are written; otherwise only the tests run it."""
    if page in EXECUTED and app.builder.format == "html":
        source[0] = with_outputs(source[0])


def skip_plain_fields(
    app: Sphinx, what: str, name: str, obj: object, skip: bool, options: object
) -> bool | None:
    """Fields of named tuples have no text of their own."""
    return True if (getattr(obj, "__doc__", None) or "").startswith("Alias for field number") else None


def show_folders_as_text(app: Sphinx, doctree: nodes.document) -> None:
    """A code host lists a folder; the site has no page for one, so its name stands without a link."""
    for node in list(doctree.findall(addnodes.pending_xref)):
        if node.get("reftype") == "myst":
            page = Path(app.env.doc2path(node["refdoc"]))
            if (page.parent / node["reftarget"]).is_dir():
                node.replace_self(node.children)


def mathml(equation: str, as_block: bool = False) -> str:
    """LaTeX as MathML, which browsers draw themselves: a page needs no script and no network."""
    return _DOTTED.sub(r"<msub><mover>\1\3</mover>\2</msub>", str(tex2mathml(equation, as_block=as_block)))


def write_math(translator: Any, node: nodes.Element) -> None:
    translator.body.append(mathml(node.astext(), as_block=isinstance(node, nodes.math_block)))
    raise nodes.SkipNode


def setup(app: Sphinx) -> None:
    app.connect("source-read", execute)
    app.connect("autodoc-process-docstring", describe, priority=50)
    app.connect("autodoc-process-docstring", prepare_docstring, priority=100)  # before napoleon
    app.connect("autodoc-process-docstring", show_example, priority=900)  # after it
    app.connect("autodoc-process-signature", shorten_signature)
    app.connect("autodoc-skip-member", skip_plain_fields)
    app.connect("doctree-read", show_folders_as_text)
    app.add_html_math_renderer("mathml", (write_math, None), (write_math, None))
