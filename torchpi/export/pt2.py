"""The step as a `.pt2` program of torch.export, a pure function that takes and returns its state.

`program(yd, state)` returns `(u, state)`: yd () float64 in µm, u () float64 in V, state (S,) float64, from
`initial_state` on. The graph follows the Python source of the deployed step with tensors in place of floats:
both branches of an `if` are computed, and `where` selects between them.
"""

import ast
import functools
import io
import json
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NoReturn

import torch
from torch import Tensor, nn

from torchpi.export.deployable import Deployable
from torchpi.export.formats import Files
from torchpi.export.parts import Function, Part, own_attribute, take_apart
from torchpi.operators.reference_filter import ReferenceFilter

CONTRACT = "contract.json"


def pt2_files(
    compensator: Deployable, output: Path, reference_filter: ReferenceFilter | None = None
) -> Files:
    """Return NAME.pt2.

    Raises:
        ArtifactError: A part has no .pt2 form, or a number is not finite.
    """
    program, contract = exported(compensator, reference_filter)
    extra = {CONTRACT: json.dumps(contract)}

    def write(path: Path) -> None:
        # Saved through a buffer, so that a full disk raises an OSError.
        buffer = io.BytesIO()
        torch.export.save(program, buffer, extra_files=dict(extra))
        path.write_bytes(buffer.getvalue())

    return {output.with_name(output.name + ".pt2"): write}


def exported(
    compensator: Deployable, reference_filter: ReferenceFilter | None = None
) -> tuple[torch.export.ExportedProgram, dict[str, Any]]:
    """Return the program, with `initial_state` as a buffer, and the constants that a control loop needs."""
    part = take_apart(compensator.stream(reference_filter), ".pt2")
    step = FunctionalStep(part)
    example = torch.zeros((), dtype=torch.float64), step.initial_state.clone()
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", category=DeprecationWarning)
        program = torch.export.export(step, example, strict=False)
    known = ("sample_period_s", "preview", "min_voltage_v", "max_voltage_v", "has_reference_filter")
    contract = {name: part.value(name) for name in known}
    return program, {**contract, "initial_state": example[1].tolist(), "state": step.names}


class FunctionalStep(nn.Module):
    """(yd, state) -> (u, state), of the same operations in the same order as the step.

    Attributes:
        initial_state: The de-energised state, (S,).
        names: Names of the states in the order of `state`; a list occupies one place per element.
    """

    def __init__(self, part: Part) -> None:
        super().__init__()
        self.part = part
        self.places = list(_states(part))
        self.names = [".".join([*owner.path, name]) for owner, name in self.places]
        values = [owner.value(name) for owner, name in self.places]
        self.sizes = [len(value) if isinstance(value, list) else 1 for value in values]
        flat = [number for value in values for number in (value if isinstance(value, list) else [value])]
        self.initial_state: Tensor
        self.register_buffer("initial_state", torch.tensor([float(n) for n in flat], dtype=torch.float64))

    def forward(self, yd: Tensor, state: Tensor) -> tuple[Tensor, Tensor]:
        pieces = state.split(self.sizes)
        values: States = {}
        for (part, name), piece in zip(self.places, pieces, strict=True):
            kind = part.value(name)
            value = piece if isinstance(kind, list) else piece[0]
            values[part.path, name] = value != 0.0 if isinstance(kind, bool) else value
        u, values = _Run(self.part, self.part.method("step"), {"yd": yd}, values).outcome()
        after = [_tensor(values[part.path, name]).to(torch.float64).reshape(-1) for part, name in self.places]
        return _tensor(u), torch.cat(after)


States = dict[tuple[tuple[str, ...], str], Any]


def _states(part: Part) -> Iterator[tuple[Part, str]]:
    yield from ((part, name) for name in part.states)
    for name, _ in part.module.named_children():
        child = part.child(name)
        if child is not None:
            yield from _states(child)


_OPERATIONS: dict[type, Callable[[Any, Any], Any]] = {
    ast.Add: lambda a, b: a + b, ast.Sub: lambda a, b: a - b, ast.Mult: lambda a, b: a * b,
    ast.Div: lambda a, b: a / b, ast.Mod: lambda a, b: a % b,
    ast.Lt: lambda a, b: a < b, ast.LtE: lambda a, b: a <= b, ast.Gt: lambda a, b: a > b,
    ast.GtE: lambda a, b: a >= b, ast.Eq: lambda a, b: a == b, ast.NotEq: lambda a, b: a != b,
    ast.And: lambda a, b: a & b, ast.Or: lambda a, b: a | b,
}  # fmt: skip


class _Run:
    """Evaluates one function from its arguments to its return value."""

    def __init__(self, part: Part, function: Function, names: dict[str, Any], states: States) -> None:
        self.part, self.function = part, function
        self.names, self.states = names, states

    def outcome(self) -> tuple[Any, States]:
        """Return the value of the function and the states after it."""
        return self._block(self.function.body), self.states

    def _block(self, statements: list[ast.stmt]) -> Any:
        """Run statements up to a return; give the returned value, or None."""
        for i, statement in enumerate(statements):
            match statement:
                case ast.If(test=test, body=body, orelse=orelse):
                    decided = self._value(test)
                    rest = statements[i + 1 :]
                    if isinstance(decided, bool):
                        return self._block((body if decided else orelse) + rest)
                    if any(isinstance(node, ast.Return) for node in ast.walk(statement)):
                        return self._either(decided, body + rest, orelse + rest)
                    self._either(decided, body, orelse)
                case ast.For(target=ast.Name(id=name), iter=several, body=body, orelse=[]):
                    for item in self._items(several):
                        self.names[name] = item
                        self._block(body)
                case ast.Return(value=value):
                    return None if value is None else self._value(value)
                case _:
                    self._statement(statement)
        return None

    def _either(self, decided: Tensor, body: list[ast.stmt], orelse: list[ast.stmt]) -> Any:
        before = dict(self.names), dict(self.states)
        yes = self._block(body)
        names, states = self.names, self.states
        self.names, self.states = before
        no = self._block(orelse)
        self.states = {key: _where(decided, states[key], self.states[key]) for key in states}
        self.names = {
            name: _where(decided, names[name], self.names[name]) for name in names if name in self.names
        }
        return _where(decided, yes, no)

    def _statement(self, node: ast.stmt) -> None:
        match node:
            case ast.Assign(targets=[target], value=value):
                self._assign(target, self._value(value))
            case ast.AnnAssign(target=target, value=ast.expr() as value):
                self._assign(target, self._value(value))
            case ast.AugAssign(target=target, op=op, value=value):
                old = self._value(ast.parse(ast.unparse(target), mode="eval").body)
                self._assign(target, self._operation(op)(old, self._value(value)))
            case ast.Expr(value=ast.Call() as call):
                self._value(call)
            case _:
                self._refuse(node)

    def _assign(self, target: ast.expr, value: Any) -> None:
        match target:
            case ast.Name(id=name):
                self.names[name] = value
            case ast.Tuple(elts=targets):
                for one, part in zip(targets, value, strict=True):
                    self._assign(one, part)
            case ast.Attribute() if own_attribute(target):
                self.states[self.part.path, target.attr] = value
            case ast.Subscript(value=ast.Attribute(attr=name) as listed, slice=index) if own_attribute(
                listed
            ):
                key = self.part.path, name
                here = torch.arange(len(self.states[key])) == self._value(index)
                self.states[key] = torch.where(here, value, self.states[key])
            case _:
                self._refuse(target)

    def _items(self, several: ast.expr) -> Any:
        name = own_attribute(several)
        parts = self.part.children(name) if name else None
        if parts is not None:
            return parts
        match several:
            case ast.Call(func=ast.Name(id="range"), args=[count], keywords=[]):
                return range(self._value(count))
            case _:
                self._refuse(several)

    def _value(self, node: ast.expr) -> Any:
        match node:
            case ast.Constant(value=bool() | int() | float() as value):
                return value
            case ast.Tuple(elts=elements):
                return tuple(self._value(element) for element in elements)
            case ast.Name(id="self"):
                return self.part
            case ast.Name(id=name) if name in self.names:
                return self.names[name]
            case ast.UnaryOp(op=ast.USub(), operand=operand):
                return -self._value(operand)
            case ast.UnaryOp(op=ast.Not(), operand=operand):
                value = self._value(operand)
                return value.logical_not() if isinstance(value, Tensor) else not value
            case ast.BinOp(left=left, op=op, right=right):
                return self._operation(op)(self._value(left), self._value(right))
            case ast.Compare(left=left, ops=[op], comparators=[right]):
                return self._operation(op)(self._value(left), self._value(right))
            case ast.BoolOp(op=op, values=values):
                return functools.reduce(self._operation(op), self._both_ways(values))
            case ast.IfExp(test=test, body=body, orelse=orelse):
                decided = self._value(test)
                if isinstance(decided, bool):
                    return self._value(body if decided else orelse)
                return _where(decided, *self._both_ways([body, orelse]))
            case ast.Attribute(value=owner, attr=name):
                return self._attribute(self._value(owner), name, node)
            case ast.Subscript(value=listed, slice=index):
                return _element(self._value(listed), self._value(index))
            case ast.Call(func=function, args=arguments, keywords=[]):
                return self._call(function, arguments)
            case _:
                self._refuse(node)

    def _both_ways(self, nodes: list[ast.expr]) -> list[Any]:
        """Evaluate all operands, although Python would evaluate only some; refuse changes of state."""
        before = dict(self.states)
        values = [self._value(node) for node in nodes]
        if any(self.states[key] is not before[key] for key in before):
            self._refuse(nodes[0])
        return values

    def _attribute(self, owner: Any, name: str, node: ast.expr) -> Any:
        if not isinstance(owner, Part):
            self._refuse(node)
        if name in owner.states:
            return self.states[owner.path, name]
        return owner.child(name) or owner.value(name)

    def _call(self, function: ast.expr, arguments: list[ast.expr]) -> Any:
        values = [self._value(argument) for argument in arguments]
        match function, values:
            case ast.Name(id="max"), [a, b]:
                return _where(b > a, b, a)
            case ast.Name(id="min"), [a, b]:
                return _where(b < a, b, a)
            case (ast.Name(id="abs"), [a]) | (ast.Name(id="float"), [a]):
                return abs(a) if function.id == "abs" else a
            case ast.Name(id="len"), [a]:
                return len(a)
            case ast.Name(id=name), _:
                called = self.part.called(self.function, name)
                return self._inside(self.part, called, values)
            case ast.Attribute(value=owner, attr=name), _ if self._is_known(owner):
                part = self._value(owner)
                if isinstance(part, Part):
                    return self._inside(part, part.method(name), values)
        self._refuse(function)

    def _is_known(self, node: ast.expr) -> bool:
        while isinstance(node, ast.Attribute):
            node = node.value
        return isinstance(node, ast.Name) and (node.id == "self" or node.id in self.names)

    def _inside(self, part: Part, function: Function, values: list[Any]) -> Any:
        names = dict(zip(function.arguments, values, strict=True))
        value, self.states = _Run(part, function, names, self.states).outcome()
        return value

    def _operation(self, op: ast.AST) -> Callable[[Any, Any], Any]:
        return _OPERATIONS.get(type(op)) or self._refuse(op)

    def _refuse(self, node: ast.AST) -> NoReturn:
        found = ast.unparse(node).splitlines()[:1] or [type(node).__name__]
        self.part.refuse(f"{self.function.tree.name}: '{found[0]}'")


def _where(decided: Any, yes: Any, no: Any) -> Any:
    if isinstance(yes, tuple):
        return tuple(_where(decided, a, b) for a, b in zip(yes, no, strict=True))
    if yes is no:
        return yes
    if isinstance(decided, bool):
        return yes if decided else no
    return torch.where(decided, _tensor(yes), _tensor(no))


def _tensor(value: Any) -> Tensor:
    # `torch.where` of two plain Python numbers would give float32.
    return value if isinstance(value, Tensor) else torch.full((), value, dtype=_dtype(value))


def _dtype(value: Any) -> torch.dtype:
    return torch.bool if isinstance(value, bool) else torch.float64


def _element(listed: Any, index: Any) -> Any:
    if not isinstance(index, Tensor):
        return listed[index]
    values = listed if isinstance(listed, Tensor) else torch.tensor(listed, dtype=torch.float64)
    return values.index_select(0, index.to(torch.int64).reshape(1))[0]
