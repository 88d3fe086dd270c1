"""Decompose a deployed step into parts, with their constants, states and the source of their methods.

The C and `.pt2` exporters read the Python source of the step itself, as TorchScript does, so that each
equation is written only once. A part is a stream (a module with `reset` and `step`) or a stream inside one.
"""

import ast
import copy
import inspect
import io
import math
import textwrap
import tokenize
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from typing import Any, NoReturn

from torch import nn

from torchpi.errors import ArtifactError

Number = float | int | bool
Value = Number | list[float]


@dataclass(frozen=True)
class Function:
    """A method, or a plain function called by one: its syntax tree, its comments by line, and its globals."""

    tree: ast.FunctionDef
    comments: dict[int, str]
    names: dict[str, Any]

    @property
    def arguments(self) -> list[str]:
        return [argument.arg for argument in self.tree.args.args if argument.arg != "self"]

    @property
    def body(self) -> list[ast.stmt]:
        has_docstring = ast.get_docstring(self.tree) is not None
        return self.tree.body[1:] if has_docstring else self.tree.body


@dataclass(frozen=True)
class Part:
    """One stream of a step.

    Attributes:
        path: Names of the attributes that lead to this part; () is the step itself.
        module: The stream, de-energised.
        form: Target format, named in error messages: 'C' or '.pt2'.
    """

    path: tuple[str, ...]
    module: nn.Module
    form: str
    _children: dict[str, "Part"] = field(default_factory=dict, repr=False)

    def __str__(self) -> str:
        name = type(self.module).__name__
        return f"part '{'.'.join(self.path)}' ({name})" if self.path else f"the step ({name})"

    def refuse(self, found: str) -> NoReturn:
        """Report which construct of this part cannot be exported.

        Raises:
            ArtifactError: Always.
        """
        raise ArtifactError(f"{self} has no {self.form} form: {found}; use --to torchscript for this model")

    def child(self, name: str) -> "Part | None":
        """Return the part that this attribute holds, or None if it holds none."""
        if not isinstance(getattr(self.module, name, None), nn.Module):
            return None
        module = getattr(self.module, name)
        return self._children.setdefault(name, Part((*self.path, name), module, self.form))

    def children(self, name: str) -> "list[Part] | None":
        """Return the parts that this attribute holds, or None if it holds no list of parts."""
        listed = self.child(name)
        if listed is None or not isinstance(listed.module, nn.ModuleList):
            return None
        return [listed.child(str(i)) or self.refuse(name) for i in range(len(listed.module))]

    def value(self, name: str) -> Value:
        """Return a constant, or the value of a state after `reset()`.

        Raises:
            ArtifactError: The value is neither a number nor a list of floats, or it is not finite.
        """
        value: Value = getattr(self.module, name, [])
        numbers = value if isinstance(value, list) else [value]
        kinds = [float] if isinstance(value, list) else [float, int, bool]
        if not numbers or not all(type(number) in kinds for number in numbers):
            self.refuse(f"self.{name} is neither a number nor a list of floats")
        if not all(math.isfinite(number) for number in numbers):
            raise ArtifactError(f"{self}: {name}: found {value}, expected finite numbers")
        return value

    @cached_property
    def states(self) -> tuple[str, ...]:
        """Names of attributes that methods of this part assign, in `__init__` order, without empty lists."""
        assigned = {name for method in self._methods.values() for name in _assigned(read(method).tree)}
        held = {name for name, value in vars(self.module).items() if value != []}
        return tuple(name for name in vars(self.module) if name in assigned & held - set(self.scratch))

    @property
    def scratch(self) -> tuple[str, ...]:
        """Names of lists that each step fills before reading, so that they carry no state."""
        return getattr(self.module, "scratch", ())

    def remark(self, name: str) -> str:
        """Return the comment that follows the assignment of an attribute in `__init__`."""
        return self._remarks.get(name, "")

    def place(self, name: str) -> int:
        """Return the position of an attribute in the order of `__init__`."""
        return list(vars(self.module)).index(name)

    @cached_property
    def _remarks(self) -> dict[str, str]:
        remarks: dict[str, str] = {}
        for cls in self._classes:
            if "__init__" not in vars(cls):
                continue
            made = read(cls.__init__)  # type: ignore[misc]
            for statement in ast.walk(made.tree):
                if isinstance(statement, (ast.Assign, ast.AnnAssign)) and statement.lineno in made.comments:
                    remarks |= dict.fromkeys(_assigned(statement), made.comments[statement.lineno])
        return remarks

    @property
    def summary(self) -> str:
        """The first line of the docstring of its class."""
        return (type(self.module).__doc__ or "").partition("\n")[0]

    def method(self, name: str) -> Function:
        """Return a method without branches that a constant excludes, with scratch lists as local numbers."""
        if name not in self._methods:
            self.refuse(f"no method '{name}' written in Python")
        function = read(self._methods[name])
        decide = _Decide(self, dict(function.comments))
        tree = decide.visit(copy.deepcopy(function.tree))
        return replace(function, tree=ast.fix_missing_locations(tree), comments=decide.comments)

    def called(self, function: Function, name: str) -> Function:
        """Return the plain function that `function` refers to by this name."""
        found = function.names.get(name)
        if not inspect.isfunction(found):
            self.refuse(f"{name}(…) is not a plain Python function")
        return read(found)

    @property
    def methods(self) -> tuple[str, ...]:
        """Names of the methods written in Python."""
        return tuple(self._methods)

    @cached_property
    def _classes(self) -> list[type]:
        """Base classes first, then the class of the module; torch's own classes are left out."""
        classes = reversed(type(self.module).__mro__)
        return [cls for cls in classes if cls is not object and not cls.__module__.startswith("torch.")]

    @cached_property
    def _methods(self) -> dict[str, Callable[..., Any]]:
        return {
            name: function
            for cls in self._classes
            for name, function in vars(cls).items()
            if inspect.isfunction(function) and name != "__init__"
        }


class WriteOut(ast.NodeTransformer):
    """Unrolls the loops that a subclass selects."""

    def __init__(self, module: nn.Module) -> None:
        self.module = module
        self.turns: dict[str, int] = {}

    def chooses(self, variable: str, loop: ast.For) -> bool:
        """Whether this loop is unrolled."""
        raise NotImplementedError

    def visit_For(self, node: ast.For) -> Any:
        match node:
            case ast.For(target=ast.Name(id=name), iter=ast.Call(args=[count])) if self.chooses(name, node):
                found = []
                for turn in range(self.number(count)):
                    self.turns[name] = turn
                    found += self.block(copy.deepcopy(node.body))
                self.turns.pop(name, None)
                return found
        return self.generic_visit(node)

    def block(self, statements: list[ast.stmt]) -> list[ast.stmt]:
        """Visit every statement and return the resulting list."""
        module = ast.Module(statements, [])
        self.generic_visit(module)
        return module.body

    def visit_Name(self, node: ast.Name) -> ast.expr:
        return ast.Constant(self.turns[node.id]) if node.id in self.turns else node

    def number(self, node: ast.expr) -> int:
        """Evaluate a count or an index from the lengths of lists and the current loop variables."""
        code = compile(ast.Expression(node), "<index>", "eval")
        return int(eval(code, {"len": len, "self": self.module, **self.turns}))


class _Decide(WriteOut):
    """Removes branches that a constant excludes, with their comments; scratch lists become local numbers."""

    def __init__(self, part: Part, comments: dict[int, str]) -> None:
        super().__init__(part.module)
        self.part, self.comments = part, comments

    def chooses(self, variable: str, loop: ast.For) -> bool:
        places = (node for node in ast.walk(loop) if isinstance(node, ast.Subscript))
        return any(
            own_attribute(one.value) in self.part.scratch and ast.unparse(one.slice) == variable
            for one in places
        )

    def visit_Subscript(self, node: ast.Subscript) -> ast.AST:
        name = own_attribute(node.value)
        if name in self.part.scratch:
            return ast.Name(f"{name}_{self.number(node.slice)}", node.ctx)
        return self.generic_visit(node)

    def visit_If(self, node: ast.If) -> Any:
        name = own_attribute(node.test)
        end, last = node.body[-1].end_lineno or 0, node.end_lineno or 0
        if name is None or name in self.part.states:
            return self.generic_visit(node)
        taken = bool(self.part.value(name))
        for line in range(end + 1, last + 1) if taken else range(node.lineno, end + 1):
            self.comments.pop(line, None)
        return self.block(node.body if taken else node.orelse)


def take_apart(stream: Any, form: str) -> Part:
    """Return the whole step as a part in the de-energised state.

    Raises:
        ArtifactError: `stream` is not a stream, or its sample period is not a positive number.
    """
    if not isinstance(stream, nn.Module):
        raise ArtifactError(
            f"{type(stream).__name__}: found no stream, expected a module with reset and step"
        )
    part = Part((), stream, form)
    stream.reset()  # type: ignore[operator]
    period = part.value("sample_period_s")
    if not isinstance(period, float) or period <= 0:
        raise ArtifactError(f"sample_period_s: found {period} s, expected a positive number of s")
    return part


@lru_cache(maxsize=256)
def read(function: Callable[..., Any]) -> Function:
    """Parse the source of a Python function."""
    text = textwrap.dedent(inspect.getsource(function))
    tree = ast.parse(text).body[0]
    assert isinstance(tree, ast.FunctionDef)
    comments = {
        token.start[0]: token.string.removeprefix("#").strip()
        for token in tokenize.generate_tokens(io.StringIO(text).readline)
        if token.type == tokenize.COMMENT and "type: ignore" not in token.string
    }
    return Function(tree, comments, function.__globals__)


def own_attribute(node: ast.AST) -> str | None:
    """Return `name` if the node is `self.name`, else None."""
    if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id == "self":
        return node.attr
    return None


def _assigned(tree: ast.AST) -> list[str]:
    names = []
    for node in ast.walk(tree):
        stored = isinstance(node, (ast.Attribute, ast.Subscript)) and isinstance(node.ctx, ast.Store)
        name = own_attribute(node.value if isinstance(node, ast.Subscript) else node) if stored else None
        if name is not None:
            names.append(name)
    return names
