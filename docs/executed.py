"""Pages whose programs run when the site is built: what a notebook would show stands below each of them."""

import ast
import re
import tempfile
import warnings
from contextlib import chdir
from typing import Any

EXECUTED = ("docs/notebook",)

_BLOCK = re.compile(r"^```python\n(.*?)^```\n", re.DOTALL | re.MULTILINE)


def with_outputs(page: str) -> str:
    """The page in Markdown, its blocks of Python cut where an expression shows something, and that below."""
    names: dict[str, Any] = {}
    with tempfile.TemporaryDirectory() as folder, chdir(folder), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return _BLOCK.sub(lambda block: _run(block[1], names), page)


def _run(block: str, names: dict[str, Any]) -> str:
    lines, shown, cells = block.splitlines(), 0, list[str]()
    for node in ast.parse(block).body:
        if not isinstance(node, ast.Expr):
            exec(compile(ast.Module([node], []), "page", "exec"), names)
            continue
        value = eval(compile(ast.Expression(node.value), "page", "eval"), names)
        if value is not None:
            cells += [*_code(lines[shown : node.end_lineno]), *_output(value)]
            shown = node.end_lineno or shown
    return "\n".join([*cells, *(_code(lines[shown:]) if any(lines[shown:]) else []), ""])


def _code(lines: list[str]) -> list[str]:
    return ["```python", *"\n".join(lines).strip("\n").splitlines(), "```"]


def _output(value: Any) -> list[str]:
    if hasattr(value, "_repr_html_"):
        return ["```{raw} html", f'<div class="output">{value._repr_html_()}</div>', "```"]
    return ["```text", repr(value), "```"]
