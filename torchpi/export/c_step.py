"""A deployed step in C: the Python of its parts, method by method, as C functions and a struct of states.

A translator of what a step is made of and no more: assignments, `if`, loops over a range or a list of
parts, calls among parts and plain functions, and + - * / with comparisons, `max`, `min` and `abs`. What it
does not know it refuses by the part's name. Operations keep their order, so the bits are those of Python.

Numbers are of type `real`, double or float as the file is compiled, but for those of `_in_double`.
"""

import ast
import re
import textwrap
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from typing import NoReturn

from torchpi.control.step_guard import IN_DOUBLE, OUT_OF_LINE
from torchpi.errors import ArtifactError
from torchpi.export.parts import Function, Part, Value, own_attribute
from torchpi.operators.motion import BackwardMotionStream
from torchpi.operators.reference_filter import ReferenceFilterStream

# Functions of the header that are methods of the step; `reset` is written from the states, `block` by hand.
PUBLIC_METHODS = ("step", "reset_at", "reset_at_voltage")
REAL, DOUBLE, INTEGER, BOOLEAN = "real", "double", "unsigned long", "bool"

KEYWORDS = frozenset(
    "auto bool break case char const continue default do double else enum extern false float for goto if "
    "inline int long real register restrict return short signed sizeof static struct switch true typedef "
    "union unsigned void volatile while".split()
)


def _in_double(part: Part, name: str | None = None) -> bool:
    """Whether a number stays double in a float build.

    What forms the rate does, and samples of the trajectory on their way there: in float32 the difference
    of two samples is off by 3e-5 of the peak rate. So does what the guard compares, for its decisions to be
    the same, and the output to stay within limits that float32 would round.
    """
    forms_the_rate = isinstance(part.module, (BackwardMotionStream, ReferenceFilterStream))
    return forms_the_rate or name in IN_DOUBLE


@dataclass(frozen=True)
class Constant:
    """A number of the step, and its comment in `__init__`."""

    part: Part
    attribute: str
    type: str

    @property
    def value(self) -> Value:
        return self.part.value(self.attribute)

    @property
    def remark(self) -> str:
        return self.part.remark(self.attribute)


class StepInC:
    """The step `part`, translated.

    Args:
        part: The step.
        name: What its names in C begin with.
        public: Names of the header, which nothing within may have.

    Attributes:
        functions: C text of each function by its name, callees first.
        constants: By their names in C, in the order in which the step meets them.
        states: Members of the struct, as paths, with type and value after a reset.
        helpers: Types for which `larger`, `smaller` and `magnitude` are called, by name.
        results: Types of several numbers that functions return: name, and type of each.

    Raises:
        ArtifactError: A part has no C form, a number is not finite, or a name is taken.
    """

    def __init__(self, part: Part, name: str, public: Collection[str]) -> None:
        self.name = name
        self._public = public
        self.functions: dict[str, str] = {}
        self.constants: dict[str, Constant] = {}
        self.states: dict[tuple[str, ...], tuple[str, Value]] = {}
        self.helpers: dict[str, str] = {}
        self.results: dict[str, list[str]] = {}
        self._keys: dict[str, object] = {REAL: REAL}
        self._returns: dict[object, tuple[str, list[str]]] = {}
        for name_ in PUBLIC_METHODS:
            self.method(part, name_)

    def method(self, part: Part, name: str) -> tuple[str, list[str]]:
        """The C name of a part's method, and the types it returns."""
        if (part.path, name) in self._returns:
            return self._returns[part.path, name]
        function = part.method(name)
        for attribute in part.states:
            self.state(part, attribute)
        public = part.path == () and name in (*PUBLIC_METHODS, "reset")
        c_name = "_".join([self.name if public else "", *part.path, name]).lstrip("_")
        if public and name == "reset":
            return c_name, []
        number = DOUBLE if _in_double(part) else REAL
        return self._function((part.path, name), part, function, c_name, number, method=True)

    def plain(self, part: Part, caller: Function, name: str, number: str) -> tuple[str, list[str]]:
        """The C name of a plain function for numbers of one type, and the types it returns."""
        function = part.called(caller, name)
        key = id(function.tree), number
        c_name = name if self._keys.get(name, key) == key else f"{name}_{number}"
        return self._function(key, part, function, c_name, number, method=False)

    def _function(
        self, key: object, part: Part, function: Function, c_name: str, number: str, *, method: bool
    ) -> tuple[str, list[str]]:
        if key not in self._returns:
            self._claim(c_name, key)
            translation = _Translation(self, part, function, c_name, number, method=method)
            self._returns[key] = c_name, translation.returned
            self.functions[c_name] = translation.text()
        return self._returns[key]

    def constant(self, part: Part, attribute: str) -> str:
        name = "_".join([*part.path, attribute]).upper()
        if name not in self.constants:
            self._claim(name, (part.path, attribute))
            self.constants[name] = Constant(part, attribute, type_of(part, attribute))
        return name

    def state(self, part: Part, attribute: str) -> str:
        path = (*member_path(part.path), attribute)
        if attribute in KEYWORDS:
            part.refuse(f"{attribute} is a word of C")
        self.states.setdefault(path, (type_of(part, attribute), part.value(attribute)))
        return "self->" + ".".join(path)

    def helper(self, kind: str, number: str) -> str:
        name = kind if number == REAL else f"{kind}_{number}"
        self._claim(name, (kind, number))
        self.helpers[name] = number
        return name

    def result(self, types: list[str]) -> str:
        name = f"{'_'.join(dict.fromkeys(types))}_{len(types)}"
        self._claim(name, tuple(types))
        self.results[name] = types
        return name

    def _claim(self, name: str, key: object) -> None:
        if name in self._public and key not in [((), public) for public in PUBLIC_METHODS]:
            raise ArtifactError(
                f"name for C: found '{self.name}', but {name} is a name within the code; "
                "give --output another last part"
            )
        if self._keys.setdefault(name, key) != key or name in KEYWORDS:
            raise ArtifactError(
                f"{name}: two things of this model would have this name in C; rename one part"
            )


def member_path(path: Sequence[str]) -> tuple[str, ...]:
    """Names of the struct's members; an element of a list is a member of its own."""
    return tuple(re.sub(r"\.(\d+)", r"_\1", ".".join(path)).split(".")) if path else ()


def type_of(part: Part, attribute: str) -> str:
    """C type of an attribute, or of a list's elements."""
    value = part.value(attribute)
    if isinstance(value, bool):
        return BOOLEAN
    if isinstance(value, int):
        return INTEGER
    return DOUBLE if _in_double(part, attribute) else REAL


def ascii_only(comment: str) -> str:
    """A comment that any compiler reads."""
    return comment.replace("µ", "u").replace("*/", "").encode("ascii", "replace").decode()


def wrapped(line: str) -> str:
    """The line in lines of a width to read."""
    indent = " " * (len(line) - len(line.lstrip(" ")) + 8)
    return "\n".join(textwrap.wrap(line, 110, subsequent_indent=indent, break_long_words=False)) or line


# C's operators by Python's, and how tightly they bind.
_OPERATORS: dict[type, tuple[str, int]] = {
    ast.Add: ("+", 12), ast.Sub: ("-", 12), ast.Mult: ("*", 13), ast.Div: ("/", 13), ast.Mod: ("%", 13),
    ast.Lt: ("<", 10), ast.LtE: ("<=", 10), ast.Gt: (">", 10), ast.GtE: (">=", 10),
    ast.Eq: ("==", 9), ast.NotEq: ("!=", 9), ast.And: ("&&", 5), ast.Or: ("||", 4),
}  # fmt: skip
_UNARY, _ATOM, _TERNARY = 14, 15, 3
_HELPERS = {"max": "larger", "min": "smaller", "abs": "magnitude"}


class _Translation:
    """One function: its lines, the types of its names."""

    def __init__(
        self, step: StepInC, part: Part, function: Function, c_name: str, number: str, *, method: bool
    ) -> None:
        self.step, self.part, self.function, self.c_name = step, part, function, c_name
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
                part.refuse(f"{name} is a word of C")

    def text(self) -> str:
        arguments = [f"{kind} {name}" for name, kind in self.types.items()]
        lines = list(self._block(self.function.body, "    ", outermost=True))
        body = [f"    {kind} {name};" for name, kind in self.hoisted.items()] + lines
        if self.is_method:
            arguments.insert(0, f"{self.step.name}_state *self")
        for argument in arguments:
            name = argument.rpartition(" ")[2].lstrip("*")
            if not any(re.search(rf"\b{name}\b", line) for line in body):
                body.insert(0, f"    (void){name};")
        kind = self.returned[0] if len(self.returned) == 1 else "void"
        if len(self.returned) > 1:
            kind = self.step.result(self.returned)
        # inline: several are called from `reset_at` as well, and the step is what must be fast.
        inline = "" if self.function.tree.name in OUT_OF_LINE else "inline "
        static = "" if self.is_public else f"static {inline}"
        head = f"{static}{kind} {self.c_name}({', '.join(arguments)})"
        return "\n".join([wrapped(head), "{", *map(wrapped, body), "}\n"])

    # Statements

    def _block(self, statements: list[ast.stmt], indent: str, outermost: bool = False) -> Iterator[str]:
        for statement in statements:
            for line in range(self.last_line + 1, statement.lineno):
                if line in self.function.comments:
                    yield f"{indent}/* {ascii_only(self.function.comments[line])} */"
            self.last_line = max(self.last_line, statement.lineno)
            lines = list(self._statement(statement, indent, outermost))
            end = statement.end_lineno or statement.lineno
            comment = self.function.comments.get(end)
            if comment and not isinstance(statement, (ast.If, ast.For)):
                lines[-1] += f" /* {ascii_only(comment)} */"
            self.last_line = max(self.last_line, end)
            yield from lines

    def _statement(self, node: ast.stmt, indent: str, outermost: bool) -> Iterator[str]:
        match node:
            case ast.Assign(targets=[ast.Tuple(elts=targets)], value=ast.Call() as call):
                yield from self._unpack(targets, call, indent, outermost)
            case ast.Assign(targets=[ast.Name(id=name)], value=value) if name not in self.loaded:
                if any(isinstance(node, ast.Call) for node in ast.walk(value)):
                    self._refuse(node)
            case ast.Assign(targets=[target], value=value):
                yield indent + self._assign(target, value, outermost)
            case ast.AnnAssign(target=target, value=ast.expr() as value):
                yield indent + self._assign(target, value, outermost)
            case ast.AugAssign(target=target, op=op, value=value):
                old = ast.parse(ast.unparse(target), mode="eval").body
                yield indent + self._assign(target, ast.BinOp(old, op, value), outermost)
            case ast.Expr(value=ast.Call() as call):
                yield f"{indent}(void){self._call(call)[0]};"
            case ast.Return(value=None):
                yield f"{indent}return;"
            case ast.Return(value=ast.Tuple(elts=values)) if len(values) == len(self.returned):
                numbers = [self._as(v, kind) for v, kind in zip(values, self.returned, strict=True)]
                yield f"{indent}return ({self.step.result(self.returned)}){{{', '.join(numbers)}}};"
            case ast.Return(value=ast.expr() as value) if len(self.returned) == 1:
                yield f"{indent}return {self._as(value, self.returned[0])};"
            case ast.If(test=test, body=body, orelse=orelse):
                yield from self._if(test, body, orelse, indent, outermost)
            case ast.For(target=ast.Name(id=name), iter=several, body=body, orelse=[]):
                yield from self._for(name, several, body, indent, outermost)
            case _:
                self._refuse(node)

    def _assign(self, target: ast.expr, value: ast.expr, outermost: bool) -> str:
        if isinstance(target, ast.Name):
            name, kind = self._local(target.id, self._type(value), outermost)
            return f"{name} = {self._as(value, kind)};"
        name, kind = self._place(target)
        return f"{name} = {self._as(value, kind)};"

    def _local(self, name: str, found: str, outermost: bool) -> tuple[str, str]:
        """A local name as the left side of an assignment, declared where it is new, and its type."""
        kind = found if found in (INTEGER, BOOLEAN) else self._number(name)
        if self.types.setdefault(name, kind) != kind:
            self.part.refuse(f"{name} is {self.types[name]} and {kind}")
        new = name not in self.declared
        self.declared.add(name)
        if new and not outermost:
            self.hoisted[name] = kind
        return (f"{kind} {name}" if new and outermost else name), kind

    def _unpack(self, targets: list[ast.expr], call: ast.Call, indent: str, outermost: bool) -> Iterator[str]:
        text, returned = self._call(call)
        if len(returned) != len(targets):
            self._refuse(call)
        result = "result"
        while result in self.declared or result in self.loaded:
            result += "_"
        self.declared.add(result)
        yield f"{indent}const {self.step.result(returned)} {result} = {text};"
        for i, (target, kind) in enumerate(zip(targets, returned, strict=True)):
            if not isinstance(target, ast.Name):
                self._refuse(target)
            elif target.id in self.loaded:
                name, to = self._local(target.id, kind, outermost)
                yield f"{indent}{name} = {_cast(f'{result}.v{i}', _ATOM, kind, to)};"

    def _if(
        self, test: ast.expr, body: list[ast.stmt], orelse: list[ast.stmt], indent: str, outermost: bool
    ) -> Iterator[str]:
        yield f"{indent}if ({self._as(test, BOOLEAN)}) {{"
        yield from self._block(body, indent + "    ")
        if orelse:
            yield f"{indent}}} else {{"
            yield from self._block(orelse, indent + "    ")
        yield f"{indent}}}"

    def _for(
        self, name: str, several: ast.expr, body: list[ast.stmt], indent: str, outermost: bool
    ) -> Iterator[str]:
        attribute = own_attribute(several)
        parts = self.part.children(attribute) if attribute else None
        if parts is not None:
            for part in parts:
                self.bound[name] = part
                self.last_line = body[0].lineno - 1
                yield from self._block(body, indent, outermost)
            return
        match several:
            case ast.Call(func=ast.Name(id="range"), args=[count], keywords=[]):
                self.types[name] = INTEGER
                self.declared.add(name)
                here = ast.Module(body, [])
                alone = all(
                    _count(self.function.tree, n) == _count(here, n) for n in _stored(here) - self.declared
                )
                yield f"{indent}for ({INTEGER} {name} = 0; {name} < {self._as(count, INTEGER)}; {name}++) {{"
                yield from self._block(body, indent + "    ", outermost=alone)
                yield f"{indent}}}"
            case _:
                self._refuse(several)

    # Expressions

    def _as(self, node: ast.expr, kind: str) -> str:
        """The expression as a number of this type, ready to be assigned or passed."""
        text, binding, found = self._expression(node, kind)
        if found != kind and {found, kind} & {INTEGER, BOOLEAN}:
            self.part.refuse(f"'{ast.unparse(node)}' is {found} where {kind} belongs")
        return _cast(text, binding, found, kind)

    def _type(self, node: ast.expr) -> str:
        return self._expression(node, self.number)[2]

    def _expression(self, node: ast.expr, target: str) -> tuple[str, int, str]:
        """Text, how tightly it binds, type. A bare number takes the type `target`."""
        # Asked for its type and for its text, at every level of an expression: answered once.
        key = ast.dump(node), target, *(part.path for part in self.bound.values())
        if key not in self.known:
            self.known[key] = self._translated(node, target)
        return self.known[key]

    def _translated(self, node: ast.expr, target: str) -> tuple[str, int, str]:
        match node:
            case ast.Constant(value=bool() as value):
                return ("true" if value else "false"), _ATOM, BOOLEAN
            case ast.Constant(value=int() as value):
                kind = target if target in (REAL, DOUBLE) else INTEGER
                return (f"{value}" if kind == INTEGER else literal(float(value), kind)), _ATOM, kind
            case ast.Constant(value=float() as value):
                kind = target if target in (REAL, DOUBLE) else self.number
                return literal(value, kind), _ATOM if kind == DOUBLE else _UNARY, kind
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
                return (str(len(held)), _ATOM, INTEGER) if isinstance(held, list) else self._refuse(node)
            case ast.Call(func=ast.Name(id="float"), args=[value], keywords=[]):
                return self._expression(value, target)
            case ast.Call(func=ast.Name(id="max" | "min" as function), args=[left, right], keywords=[]):
                kind, a, b = self._pair(left, right, 0, target)
                return f"{self.step.helper(_HELPERS[function], kind)}({a}, {b})", _ATOM, kind
            case ast.Call(func=ast.Name(id="abs"), args=[value], keywords=[]):
                text, _, kind = self._expression(value, target)
                return f"{self.step.helper('magnitude', kind)}({text})", _ATOM, kind
            case ast.Call() as call:
                text, returned = self._call(call)
                return (text, _ATOM, returned[0]) if len(returned) == 1 else self._refuse(node)
            case ast.Name(id=name) if name in self.types:
                return name, _ATOM, self.types[name]
            case _:
                name, kind = self._place(node)
                return name, _ATOM, kind

    def _pair(self, left: ast.expr, right: ast.expr, binding: int, target: str) -> tuple[str, str, str]:
        """Both sides as numbers of the wider of their types; C groups from the left as Python does."""
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
            cast = _cast(text, tight, found, kind)
            texts.append(_inside(cast, tight if cast == text else _UNARY, least))
        return kind, texts[0], texts[1]

    def _keep_order(self, sides: list[ast.expr]) -> None:
        """Refuse what depends on which side comes first, which C leaves open: a part's step beside another
        step, or beside a state."""
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
                c_name, returned = self.step.plain(self.part, self.function, name, number)
                target = [number] * len(call.args)
                return f"{c_name}({self._arguments(call, target)})", returned
            case ast.Attribute(value=owner, attr=name):
                part = self._part(owner, call)
                c_name, returned = self.step.method(part, name)
                target = [
                    DOUBLE if _in_double(part, argument) else REAL if kind == "float" else kind
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
        """The C name and type of an attribute of a part, or of an element of one."""
        match node:
            case ast.Attribute(value=owner, attr=name):
                part = self._part(owner, node)
                held = part.value(name)
                if isinstance(held, list):
                    self._refuse(node)
                held_by = self.step.state if name in part.states else self.step.constant
                return held_by(part, name), type_of(part, name)
            case ast.Subscript(value=ast.Attribute(value=owner, attr=name), slice=index):
                part = self._part(owner, node)
                if not isinstance(part.value(name), list):
                    self._refuse(node)
                held_by = self.step.state if name in part.states else self.step.constant
                return f"{held_by(part, name)}[{self._as(index, INTEGER)}]", type_of(part, name)
            case _:
                self._refuse(node)

    # Types

    def _number(self, name: str) -> str:
        return DOUBLE if self.is_method and _in_double(self.part, name) else self.number

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


def _stored(tree: ast.AST) -> set[str]:
    return {n.id for n in ast.walk(tree) if isinstance(n, ast.Name) and isinstance(n.ctx, ast.Store)}


def _count(tree: ast.AST, name: str) -> int:
    return sum(isinstance(node, ast.Name) and node.id == name for node in ast.walk(tree))


def literal(value: float, kind: str) -> str:
    """A number that C reads back to the last bit."""
    return repr(value) if kind == DOUBLE else f"(real){value!r}"


def _annotations(function: Function) -> list[tuple[str, str]]:
    c_types = {"int": INTEGER, "bool": BOOLEAN}
    return [
        (argument.arg, c_types.get(ast.unparse(argument.annotation), "float") if argument.annotation else "")
        for argument in function.tree.args.args
        if argument.arg != "self"
    ]


def _cast(text: str, binding: int, found: str, target: str) -> str:
    return text if found == target else f"({target}){_inside(text, binding, _UNARY)}"


def _inside(text: str, binding: int, least: int) -> str:
    return text if binding >= least else f"({text})"


def _unsigned(node: ast.expr) -> ast.expr:
    return node.operand if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub) else node
