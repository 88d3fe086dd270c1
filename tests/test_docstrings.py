"""Docstrings of the public names: parameters, shapes, units, errors; the examples in them run."""

import ast
import doctest
import inspect
import re
import sys
import textwrap
from collections.abc import Callable, Iterator
from pathlib import Path
from types import FunctionType
from typing import Any

import pytest

from docs.described import described, is_record, section
from tests.notebook.test_docstrings import DOCUMENTED as IN_NOTEBOOK
from tests.test_docs import documented

PUBLIC = documented()
ERRORS = ("RecordingError", "ConfigError", "StageError", "ArtifactError", "SimulationError")
ARRAY = re.compile(r"\b(Tensor|ndarray|NDArray|ArrayLike|Signal)\b")
SHAPE = re.compile(r"\((?:[\w +-]+,|[\w +-]+(?:, [\w +-]+)+)\)")
UNIT = re.compile(r"µ[ms]|\bV\b|\bs\b|\bHz\b|\bunits?\b|bool|counts")


def methods(of: Any) -> Iterator[tuple[str, Callable[..., Any]]]:
    """Yield public methods that a class adds; an override has the docstring of the method it overrides."""
    for name, value in vars(of).items():
        function = getattr(value, "__func__", value)
        overrides = any(name in vars(base) for base in of.__mro__[1:])
        if isinstance(function, FunctionType) and not name.startswith("_") and not overrides:
            yield name, function


def callables() -> dict[str, Any]:
    """Public functions and classes, and the methods of the classes."""
    found = {}
    for name, value in PUBLIC.items():
        found[name] = value
        if inspect.isclass(value):
            found |= {f"{name}.{method}": function for method, function in methods(value)}
    return found


CALLABLES = callables()


def parameters(of: Any) -> list[inspect.Parameter]:
    if inspect.isclass(of) and issubclass(of, Exception):
        return []
    passed_on = (inspect.Parameter.VAR_POSITIONAL, inspect.Parameter.VAR_KEYWORD)
    found = inspect.signature(of).parameters.values()
    return [one for one in found if one.kind not in passed_on and one.name not in ("self", "cls")]


def raised(of: Any) -> set[str]:
    """Return the errors of torchpi raised in the source of a function or of a class's constructor."""
    functions = [of]
    if inspect.isclass(of):
        functions = [vars(of)[name] for name in ("__init__", "__post_init__") if name in vars(of)]
    try:
        source = "\n".join(textwrap.dedent(inspect.getsource(one)) for one in functions)
    except (OSError, TypeError):  # the constructor that `dataclass` makes
        return set()
    calls = [
        node.exc.func
        for node in ast.walk(ast.parse(source))
        if isinstance(node, ast.Raise) and isinstance(node.exc, ast.Call)
    ]
    return {call.id for call in calls if isinstance(call, ast.Name)} & set(ERRORS)


@pytest.mark.parametrize("name", [name for name, value in PUBLIC.items() if not is_record(value)])
def test_every_parameter_is_described(name: str) -> None:
    text = described(PUBLIC[name])
    assert [one.name for one in parameters(PUBLIC[name]) if not text.get(one.name)] == []


@pytest.mark.parametrize("name", CALLABLES)
def test_every_array_is_described_with_shape_and_unit(name: str) -> None:
    text = described(CALLABLES[name])
    whole = inspect.getdoc(CALLABLES[name]) or ""
    for one in parameters(CALLABLES[name]):
        annotation = inspect.formatannotation(one.annotation)
        if ARRAY.search(annotation) and "Callable" not in annotation:
            said = text.get(one.name, whole)
            assert SHAPE.search(said) or "same shape" in said, f"{one.name}: {said}"
            assert UNIT.search(said), f"{one.name}: {said}"


@pytest.mark.parametrize("name", CALLABLES)
def test_every_raised_error_is_documented(name: str) -> None:
    """Errors may be documented by the method or by its class."""
    of_class = PUBLIC.get(name.rpartition(".")[0])
    stated = section(CALLABLES[name], "Raises") + (section(of_class, "Raises") if of_class else "")
    assert [error for error in sorted(raised(CALLABLES[name])) if error not in stated] == []


def examples() -> dict[str, doctest.DocTest]:
    """Return the examples of public names and of their members, each to be run by itself."""
    finder, found = doctest.DocTestFinder(exclude_empty=True), {}
    in_notebook = {one.__qualname__ for one in IN_NOTEBOOK}  # run in sequence by a test there
    for name, value in PUBLIC.items():
        for one in finder.find(value, name, inspect.getmodule(value), globs={}):
            if one.name.removeprefix(f"{name.rpartition('.')[0]}.") not in in_notebook and one.examples:
                found[one.name] = one
    return found


EXAMPLES = examples()


@pytest.mark.parametrize("name", EXAMPLES)
def test_examples_in_docstrings_give_the_stated_results(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [*sys.path])  # a user-defined simulation is imported from here
    said: list[str] = []
    result = doctest.DocTestRunner().run(EXAMPLES[name], out=said.append)
    assert result.failed == 0, "".join(said)
    assert any(one.want for one in EXAMPLES[name].examples), "nothing is shown"
