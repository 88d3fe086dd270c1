"""What the source says of each parameter and field: in `Args:` or `Attributes:`, or beside or below it."""

import ast
import dataclasses
import inspect
import re
import textwrap
from typing import Any

Described = dict[str, str]  # text by name

_SECTION = re.compile(r"^(?:Args|Attributes|Example|Raises|Returns|Warns)(?:, \w+)*:$", re.MULTILINE)
_ENTRY = re.compile(r"^(\w+(?:, \w+)*): ?(.*)$")
_COMMENT = re.compile(r"\s# (?!type: |noqa|fmt: )([^#]+)$")
_AS_ELSEWHERE = re.compile(r"Arguments and errors are those of `(\w+)`\.")


def is_record(obj: Any) -> bool:
    """A class of fields, which have their units in their names, or text where there is more to say."""
    return inspect.isclass(obj) and (dataclasses.is_dataclass(obj) or issubclass(obj, tuple))


def docstring_of(obj: Any) -> str:
    """Its own, with the sections of the function whose arguments and errors it says to have."""
    text = inspect.cleandoc(obj.__doc__ or "")
    if other := _AS_ELSEWHERE.search(text):
        start, *sections = _sections(text)
        _, *added = _sections(docstring_of(inspect.getmodule(obj).__dict__[other[1]]))
        return "\n\n".join([start.replace(other[0], "").rstrip(), *added, *sections])
    return text


def _sections(docstring: str) -> list[str]:
    """What comes before them, then each."""
    return [part.rstrip() for part in re.split(f"(?={_SECTION.pattern})", docstring, flags=re.MULTILINE)]


def with_parameters(obj: Any, docstring: str) -> str:
    """A docstring that describes all parameters in `Args:`."""
    text = described(obj)
    try:
        names = [name for name in inspect.signature(obj).parameters if text.get(name)]
    except ValueError:  # of exceptions, whose constructor is built in
        return docstring
    start, *sections = _sections(docstring)
    args = ["Args:\n" + "\n".join(f"    {name}: {text[name]}" for name in names)] if names else []
    return "\n\n".join([start, *args, *(one for one in sections if not one.startswith("Args"))])


def section(obj: Any, title: str) -> str:
    """Its dedented text; empty where there is none."""
    found = [part.partition("\n") for part in _sections(docstring_of(obj))[1:]]
    return "\n".join(textwrap.dedent(text) for head, _, text in found if title in re.findall(r"\w+", head))


def entries(text: str) -> Described:
    """Of a section; names that are described together have the same text."""
    found: Described = {}
    names: list[str] = []
    for line in text.splitlines():
        if entry := _ENTRY.match(line):
            names = entry[1].split(", ")
            found |= dict.fromkeys(names, entry[2])
        else:
            found |= {name: f"{found[name]} {line.strip()}".strip() for name in names}
    return found


def beside(obj: Any) -> Described:
    """The comments beside the parameters of a function, or beside and below the fields of a class."""
    try:
        source = textwrap.dedent(inspect.getsource(obj))
    except (OSError, TypeError):  # made by a decorator
        return {}
    tree, lines = ast.parse(source).body[0], source.splitlines()
    found: Described = {}
    at: list[tuple[str, int]] = []
    if isinstance(tree, ast.FunctionDef):
        arguments = [*tree.args.posonlyargs, *tree.args.args, *tree.args.kwonlyargs]
        at = [(one.arg, one.lineno) for one in arguments]
    elif isinstance(tree, ast.ClassDef):
        for node, below in zip(tree.body, [*tree.body[1:], None], strict=True):
            if isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
                at.append((node.target.id, node.end_lineno or node.lineno))
                if isinstance(below, ast.Expr) and isinstance(below.value, ast.Constant):
                    found[node.target.id] = " ".join(str(below.value.value).split())
    for name, line in at:
        comment = _COMMENT.search(lines[line - 1])
        if comment and [other for _, other in at].count(line) == 1:
            found.setdefault(name, comment[1])
    return found


def described(obj: Any) -> Described:
    """Text by parameter or field, of a class also what it inherits; what stands beside it comes first."""
    found: Described = {}
    for one in reversed(obj.__mro__) if inspect.isclass(obj) else [obj]:
        if one.__module__.startswith("torchpi"):
            made = vars(one).get("__init__") if inspect.isclass(one) else None
            comments = (beside(made) if inspect.isfunction(made) else {}) | beside(one)
            texts = entries(section(one, "Attributes")) | entries(section(one, "Args"))
            both = {name: f"{comments[name]}: {text}" for name, text in texts.items() if name in comments}
            found |= comments | texts | both
    return found
