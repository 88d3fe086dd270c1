"""Translate a deployed step to C: each Python method of its parts to a C function, its states to a struct.

The translator covers only what a step needs: assignments, `if`, loops over a range or a list of parts, calls
among parts and plain functions, and + - * / with comparisons, `max`, `min` and `abs`. It refuses anything
else and names the part. Operations keep their order, so the results equal those of Python to the last bit.
"""

import ast
import re
import textwrap
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass

from torchpi.control.step_guard import OUT_OF_LINE
from torchpi.errors import ArtifactError
from torchpi.export.c_expression import (
    ATOM,
    BOOLEAN,
    DOUBLE,
    INTEGER,
    KEYWORDS,
    PUBLIC_METHODS,
    REAL,
    Expressions,
    cast,
    in_double,
    type_of,
)
from torchpi.export.parts import Function, Part, Value, own_attribute


@dataclass(frozen=True)
class Constant:
    """A constant of the step, and its comment in `__init__`."""

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
    """The translation of the step `part`.

    Args:
        part: The step.
        name: Prefix of its names in C.
        public: Names in the header, which no name inside the code may repeat.

    Attributes:
        functions: C text of each function by name, callees first.
        constants: Constants by their names in C, in the order in which the step uses them.
        states: Members of the struct, by path, with type and value after a reset.
        helpers: Types for which `larger`, `smaller` and `magnitude` are called, by name.
        results: Structs for functions that return several numbers: name, and the type of each number.

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
        """Return the C name of a method of a part, and the types it returns."""
        if (part.path, name) in self._returns:
            return self._returns[part.path, name]
        function = part.method(name)
        for attribute in part.states:
            self.state(part, attribute)
        public = part.path == () and name in (*PUBLIC_METHODS, "reset")
        c_name = "_".join([self.name if public else "", *part.path, name]).lstrip("_")
        if public and name == "reset":
            return c_name, []
        number = DOUBLE if in_double(part) else REAL
        return self._function((part.path, name), part, function, c_name, number, method=True)

    def plain(self, part: Part, caller: Function, name: str, number: str) -> tuple[str, list[str]]:
        """Return the C name of a plain function for numbers of one type, and the types it returns."""
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
            part.refuse(f"{attribute} is a reserved word of C")
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
                "change the last part of --output"
            )
        if self._keys.setdefault(name, key) != key or name in KEYWORDS:
            raise ArtifactError(
                f"{name}: two objects of this model would have this name in C; rename one part"
            )


def member_path(path: Sequence[str]) -> tuple[str, ...]:
    """Return the names of the members of the struct; each element of a list is a separate member."""
    return tuple(re.sub(r"\.(\d+)", r"_\1", ".".join(path)).split(".")) if path else ()


def ascii_only(comment: str) -> str:
    """Return a comment in ASCII, which any compiler reads."""
    return comment.replace("µ", "u").replace("*/", "").encode("ascii", "replace").decode()


def wrapped(line: str) -> str:
    """Wrap a line to a readable width."""
    indent = " " * (len(line) - len(line.lstrip(" ")) + 8)
    return "\n".join(textwrap.wrap(line, 110, subsequent_indent=indent, break_long_words=False)) or line


class _Translation(Expressions):
    """Translates one function into lines of C."""

    def __init__(
        self, step: StepInC, part: Part, function: Function, c_name: str, number: str, *, method: bool
    ) -> None:
        super().__init__(step, part, function, number, method=method)
        self.step, self.c_name = step, c_name

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
        # Inline, because several are also called from `reset_at`, and the step must be fast.
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
        """Return a local name as the left side of an assignment, declared if it is new, and its type."""
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
                yield f"{indent}{name} = {cast(f'{result}.v{i}', ATOM, kind, to)};"

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


def _stored(tree: ast.AST) -> set[str]:
    return {n.id for n in ast.walk(tree) if isinstance(n, ast.Name) and isinstance(n.ctx, ast.Store)}


def _count(tree: ast.AST, name: str) -> int:
    return sum(isinstance(node, ast.Name) and node.id == name for node in ast.walk(tree))
