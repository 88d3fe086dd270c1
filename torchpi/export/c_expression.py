"""Expressions of a deployed step in C: text, operator precedence and type.

Numbers have type `real` (double or float, chosen when the file is compiled), except those of `in_double`.
"""

import ast
from typing import NoReturn, Protocol

from torchpi.control.step_guard import IN_DOUBLE
from torchpi.export.parts import Function, Part, own_attribute
from torchpi.operators.motion import BackwardMotionStream
from torchpi.operators.reference_filter import ReferenceFilterStream

# Header functions translated from methods; `reset` is generated from the states, `block` is written by hand.
PUBLIC_METHODS = ("step", "reset_at", "reset_at_voltage")
REAL, DOUBLE, INTEGER, BOOLEAN = "real", "double", "unsigned long", "bool"

KEYWORDS = frozenset(
    "auto bool break case char const continue default do double else enum extern false float for goto if "
    "inline int long real register restrict return short signed sizeof static struct switch true typedef "
    "union unsigned void volatile while".split()
)


def in_double(part: Part, name: str | None = None) -> bool:
    """Whether a number stays double in a float build.

    The numbers that form the rate, and the trajectory samples that lead to them, stay double: in float32 the
    difference of two samples is off by 3e-5 of the peak rate. The numbers that the guard compares stay double
    so that its decisions are the same, and the output so that it keeps to limits that float32 would round.
    """
    forms_the_rate = isinstance(part.module, (BackwardMotionStream, ReferenceFilterStream))
    return forms_the_rate or name in IN_DOUBLE


def type_of(part: Part, attribute: str) -> str:
    """Return the C type of an attribute, or of the elements of a list."""
    value = part.value(attribute)
    if isinstance(value, bool):
        return BOOLEAN
    if isinstance(value, int):
        return INTEGER
    return DOUBLE if in_double(part, attribute) else REAL


def literal(value: float, kind: str) -> str:
    """Return a literal that C reads back to the last bit."""
    return repr(value) if kind == DOUBLE else f"(real){value!r}"


# C operators and their precedence (higher binds tighter), by the Python operators.
_OPERATORS: dict[type, tuple[str, int]] = {
    ast.Add: ("+", 12), ast.Sub: ("-", 12), ast.Mult: ("*", 13), ast.Div: ("/", 13), ast.Mod: ("%", 13),
    ast.Lt: ("<", 10), ast.LtE: ("<=", 10), ast.Gt: (">", 10), ast.GtE: (">=", 10),
    ast.Eq: ("==", 9), ast.NotEq: ("!=", 9), ast.And: ("&&", 5), ast.Or: ("||", 4),
}  # fmt: skip
_UNARY, ATOM, _TERNARY = 14, 15, 3
_HELPERS = {"max": "larger", "min": "smaller", "abs": "magnitude"}


class Names(Protocol):
    """Supplies the C names of the operands of expressions."""

    def method(self, part: Part, name: str) -> tuple[str, list[str]]: ...
    def plain(self, part: Part, caller: Function, name: str, number: str) -> tuple[str, list[str]]: ...
    def constant(self, part: Part, attribute: str) -> str: ...
    def state(self, part: Part, attribute: str) -> str: ...
    def helper(self, kind: str, number: str) -> str: ...


class Expressions:
    """Translates the expressions of one function and tracks the types of its names."""

    def __init__(self, step: Names, part: Part, function: Function, number: str, *, method: bool) -> None:
        self.names, self.part, self.function = step, part, function
        self.number = number
        self.is_method = method
        self.is_public = method and part.path == () and function.tree.name in PUBLIC_METHODS
        self.types = {
            argument.arg: self._argument(argument)
            for argument in function.tree.args.args
            if argument.arg != "self"
        }
        self.declared = set(self.types)
        self.hoisted: dict[str, str] = {}
        self.bound: dict[str, Part] = {}
        self.known: dict[tuple, tuple[str, int, str]] = {}
        self.loaded = {
            node.id
            for node in ast.walk(function.tree)
            if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Load)
        }
        self.last_line = function.tree.lineno
        self.returned = self._annotated(function.tree.returns)
        for name in {node.id for node in ast.walk(function.tree) if isinstance(node, ast.Name)}:
            if name in KEYWORDS and name not in ("float", "bool", "int"):
                part.refuse(f"{name} is a reserved word of C")

    def _as(self, node: ast.expr, kind: str) -> str:
        """Return the expression converted to type `kind`, ready to be assigned or passed."""
        text, binding, found = self._expression(node, kind)
        if found != kind and {found, kind} & {INTEGER, BOOLEAN}:
            self.part.refuse(f"'{ast.unparse(node)}' is {found} where {kind} is required")
        return cast(text, binding, found, kind)

    def _type(self, node: ast.expr) -> str:
        return self._expression(node, self.number)[2]

    def _expression(self, node: ast.expr, target: str) -> tuple[str, int, str]:
        """Return text, precedence and type of an expression; a literal takes the type `target`."""
        # Cached, because every level of an expression asks for the type and the text of its operands.
        key = ast.dump(node), target, *(part.path for part in self.bound.values())
        if key not in self.known:
            self.known[key] = self._translated(node, target)
        return self.known[key]

    def _translated(self, node: ast.expr, target: str) -> tuple[str, int, str]:
        match node:
            case ast.Constant(value=bool() as value):
                return ("true" if value else "false"), ATOM, BOOLEAN
            case ast.Constant(value=int() as value):
                kind = target if target in (REAL, DOUBLE) else INTEGER
                return (f"{value}" if kind == INTEGER else literal(float(value), kind)), ATOM, kind
            case ast.Constant(value=float() as value):
                kind = target if target in (REAL, DOUBLE) else self.number
                return literal(value, kind), ATOM if kind == DOUBLE else _UNARY, kind
            case ast.UnaryOp(op=ast.USub(), operand=operand):
                text, binding, kind = self._expression(operand, target)
                if kind in (INTEGER, BOOLEAN):
                    self._refuse(node)
                return f"-{_inside(text, binding, _UNARY + 1)}", _UNARY, kind
            case ast.UnaryOp(op=ast.Not(), operand=operand):
                text, binding, _ = self._expression(operand, BOOLEAN)
                return f"!{_inside(text, binding, _UNARY)}", _UNARY, BOOLEAN
            case ast.BinOp(left=left, op=op, right=right):
                symbol, binding = _OPERATORS.get(type(op)) or self._refuse(node)
                kind, a, b = self._pair(left, right, binding, target)
                if kind == BOOLEAN or symbol == ("/" if kind == INTEGER else "%"):
                    self._refuse(node)
                return f"{a} {symbol} {b}", binding, kind
            case ast.Compare(left=left, ops=[op], comparators=[right]):
                symbol, binding = _OPERATORS.get(type(op)) or self._refuse(node)
                _, a, b = self._pair(left, right, binding, self.number)
                return f"{a} {symbol} {b}", binding, BOOLEAN
            case ast.BoolOp(op=op, values=values):
                symbol, binding = _OPERATORS[type(op)]
                texts = [_inside(*self._expression(v, BOOLEAN)[:2], 9) for v in values]
                return f" {symbol} ".join(texts), binding, BOOLEAN
            case ast.IfExp(test=test, body=body, orelse=orelse):
                kind, a, b = self._pair(body, orelse, _TERNARY + 1, target)
                condition = _inside(*self._expression(test, BOOLEAN)[:2], _TERNARY + 1)
                return f"{condition} ? {a} : {b}", _TERNARY, kind
            case ast.Call(func=ast.Name(id="len"), args=[listed], keywords=[]) if own_attribute(listed):
                held = self.part.value(own_attribute(listed) or "")
                return (str(len(held)), ATOM, INTEGER) if isinstance(held, list) else self._refuse(node)
            case ast.Call(func=ast.Name(id="float"), args=[value], keywords=[]):
                return self._expression(value, target)
            case ast.Call(func=ast.Name(id="max" | "min" as function), args=[left, right], keywords=[]):
                kind, a, b = self._pair(left, right, 0, target)
                return f"{self.names.helper(_HELPERS[function], kind)}({a}, {b})", ATOM, kind
            case ast.Call(func=ast.Name(id="abs"), args=[value], keywords=[]):
                text, _, kind = self._expression(value, target)
                return f"{self.names.helper('magnitude', kind)}({text})", ATOM, kind
            case ast.Call() as call:
                text, returned = self._call(call)
                return (text, ATOM, returned[0]) if len(returned) == 1 else self._refuse(node)
            case ast.Name(id=name) if name in self.types:
                return name, ATOM, self.types[name]
            case _:
                name, kind = self._place(node)
                return name, ATOM, kind

    def _pair(self, left: ast.expr, right: ast.expr, binding: int, target: str) -> tuple[str, str, str]:
        """Convert both sides to the wider of their types; C groups from the left as Python does."""
        self._keep_order([left, right])
        sides = left, right
        bare = [isinstance(_unsigned(side), ast.Constant) for side in sides]
        kinds = [
            self._expression(s, target)[2] for s, literal_ in zip(sides, bare, strict=True) if not literal_
        ]
        kinds = kinds or [self._expression(s, target)[2] for s in sides]
        kind = next((k for k in (DOUBLE, REAL, INTEGER, BOOLEAN) if k in kinds), REAL)
        if INTEGER in kinds and kind != INTEGER:
            self.part.refuse(f"whole and real numbers in one expression, at '{ast.unparse(left)}'")
        texts = []
        for side, least in zip(sides, (binding, binding + 1), strict=True):
            text, tight, found = self._expression(side, kind)
            converted = cast(text, tight, found, kind)
            texts.append(_inside(converted, tight if converted == text else _UNARY, least))
        return kind, texts[0], texts[1]

    def _keep_order(self, sides: list[ast.expr]) -> None:
        """Refuse operands whose evaluation order matters, because C leaves it unspecified: the step of a part
        beside another step or beside a state."""
        moving = [side for side in sides if any(_is_method_call(node) for node in ast.walk(side))]
        still = [side for side in sides if side not in moving]
        if len(moving) > 1 or (moving and any(self._reads_state(n) for s in still for n in ast.walk(s))):
            self.part.refuse(
                f"a step of a part beside another step or a state, in an order that C leaves open, "
                f"at '{ast.unparse(sides[0])}'"
            )

    def _reads_state(self, node: ast.AST) -> bool:
        name = own_attribute(node)
        return isinstance(node, ast.Attribute) and (name is None or name in self.part.states)

    def _call(self, call: ast.Call) -> tuple[str, list[str]]:
        if call.keywords:
            self._refuse(call)
        match call.func:
            case ast.Name(id=name):
                kinds = [self._type(argument) for argument in call.args]
                number = DOUBLE if DOUBLE in kinds else REAL
                c_name, returned = self.names.plain(self.part, self.function, name, number)
                target = [number] * len(call.args)
                return f"{c_name}({self._arguments(call, target)})", returned
            case ast.Attribute(value=owner, attr=name):
                part = self._part(owner, call)
                c_name, returned = self.names.method(part, name)
                target = [
                    DOUBLE if in_double(part, argument) else REAL if kind == "float" else kind
                    for argument, kind in _annotations(part.method(name))
                ]
                given = self._arguments(call, target)
                return f"{c_name}(self{', ' + given if given else ''})", returned
            case _:
                self._refuse(call)

    def _arguments(self, call: ast.Call, target: list[str]) -> str:
        if len(target) != len(call.args):
            self._refuse(call)
        self._keep_order(call.args)
        return ", ".join(self._as(a, kind) for a, kind in zip(call.args, target, strict=True))

    def _part(self, node: ast.expr, within: ast.expr) -> Part:
        match node:
            case ast.Name(id="self") if self.is_method:
                return self.part
            case ast.Name(id=name) if name in self.bound:
                return self.bound[name]
            case ast.Attribute(value=owner, attr=name):
                return self._part(owner, within).child(name) or self._refuse(within)
            case _:
                self._refuse(within)

    def _place(self, node: ast.expr) -> tuple[str, str]:
        """Return the C name and type of an attribute of a part, or of an element of one."""
        match node:
            case ast.Attribute(value=owner, attr=name):
                part = self._part(owner, node)
                held = part.value(name)
                if isinstance(held, list):
                    self._refuse(node)
                held_by = self.names.state if name in part.states else self.names.constant
                return held_by(part, name), type_of(part, name)
            case ast.Subscript(value=ast.Attribute(value=owner, attr=name), slice=index):
                part = self._part(owner, node)
                if not isinstance(part.value(name), list):
                    self._refuse(node)
                held_by = self.names.state if name in part.states else self.names.constant
                return f"{held_by(part, name)}[{self._as(index, INTEGER)}]", type_of(part, name)
            case _:
                self._refuse(node)

    # Types

    def _number(self, name: str) -> str:
        return DOUBLE if self.is_method and in_double(self.part, name) else self.number

    def _argument(self, argument: ast.arg) -> str:
        kind = self._annotated(argument.annotation)
        return self._number(argument.arg) if kind[0] in (REAL, DOUBLE) else kind[0]

    def _annotated(self, node: ast.expr | None) -> list[str]:
        match node:
            case ast.Constant(value=None):
                return []
            case ast.Name(id="float"):
                return [DOUBLE if self.is_public else self.number]
            case ast.Name(id="int"):
                return [INTEGER]
            case ast.Name(id="bool"):
                return [BOOLEAN]
            case ast.Subscript(value=ast.Name(id="tuple"), slice=ast.Tuple(elts=kinds)):
                return [self._annotated(kind)[0] for kind in kinds]
            case _:
                self.part.refuse(f"{self.function.tree.name} with a value that is not float, int or bool")

    def _refuse(self, node: ast.AST) -> NoReturn:
        self.part.refuse(f"{self.function.tree.name}: '{ast.unparse(node).splitlines()[0]}'")


def _is_method_call(node: ast.AST) -> bool:
    return isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute)


def _annotations(function: Function) -> list[tuple[str, str]]:
    c_types = {"int": INTEGER, "bool": BOOLEAN}
    return [
        (argument.arg, c_types.get(ast.unparse(argument.annotation), "float") if argument.annotation else "")
        for argument in function.tree.args.args
        if argument.arg != "self"
    ]


def cast(text: str, binding: int, found: str, target: str) -> str:
    return text if found == target else f"({target}){_inside(text, binding, _UNARY)}"


def _inside(text: str, binding: int, least: int) -> str:
    return text if binding >= least else f"({text})"


def _unsigned(node: ast.expr) -> ast.expr:
    return node.operand if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub) else node
