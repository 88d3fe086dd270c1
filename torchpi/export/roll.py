"""Loops put back: statements that repeat with numbered names become one loop over lists.

The written-out step names its numbers one by one, because TorchScript is fastest so:

    h0 = play(s, self.r_0, self.h0)           for i in range(2):
    self.h0 = h0                                  h = play(s, self.r[i], self.h[i])
    h1 = play(s, self.r_1, self.h1)               self.h[i] = h
    self.h1 = h1

In C the right-hand form reads better, and compilers make vector code of it. The operations, and their
order, are the same.
"""

import ast
import copy
import re
from dataclasses import replace

from torchpi.export.parts import Function, Part, own_attribute

LONGEST = 8  # statements in one turn of a loop
FEWEST = 3  # turns that are worth a loop


def roll(part: Part, function: Function) -> Function:
    """The method with its loops; `part` then knows the lists that it goes through."""
    # A copy, since what is read of a function is kept for the other parts and formats that have it.
    function = replace(function, tree=copy.deepcopy(function.tree))
    statements, rolled = list(function.body), []
    while statements:
        length, turns = max(
            ((length, _turns(statements, length)) for length in range(1, LONGEST + 1)),
            key=lambda found: found[0] * found[1] if found[1] >= FEWEST else 0,
        )
        blocks = [statements[k * length : (k + 1) * length] for k in range(turns)]
        loop = _loop(part, function, blocks) if turns >= FEWEST else None
        count = length * turns if loop else 1
        rolled.append(loop or statements[0])
        statements = statements[count:]
    tree = ast.FunctionDef(**{**vars(function.tree), "body": rolled})
    # Elsewhere in the method, a list's elements by their places.
    tree = _Elements(part).visit(tree)
    return replace(function, tree=ast.fix_missing_locations(tree))


def _turns(statements: list[ast.stmt], length: int) -> int:
    """How often the first `length` statements repeat, each time with the next number."""
    first, turns = statements[:length], 1
    while True:
        block = statements[turns * length : (turns + 1) * length]
        if len(block) < length or not all(_follows(a, b, turns) for a, b in zip(first, block, strict=True)):
            return turns
        turns += 1


def _follows(first: ast.AST, later: ast.AST, turns: int) -> bool:
    a, b = _names(first), _names(later)
    if _blank(first) != _blank(later) or len(a) != len(b):
        return False
    return all(x == y or _numbered(x, y, turns) is not None for x, y in zip(a, b, strict=True))


def _loop(part: Part, function: Function, blocks: list[list[ast.stmt]]) -> ast.For | None:
    """The loop over these blocks, or None where it would not be the same."""
    columns = set(zip(*([name for s in block for name in _names(s)] for block in blocks), strict=True))
    lists = {names: _without_number(*names[:2]) for names in columns if names[0] != names[1]}
    attributes = {_bare(names): _bare((name,))[0] for names, name in lists.items() if _is_attribute(name)}
    locals_ = {names: name for names, name in lists.items() if not _is_attribute(name)}
    everywhere, within = (
        _locals(function.tree),
        [name for block in blocks for s in block for name in _locals(s)],
    )
    turn_by_turn = {name for names in locals_ for name in names}
    if (
        # A name means one thing in a turn, and a list holds one thing.
        len({names[0] for names in columns}) < len(columns)
        or len(set(lists.values())) < len(lists)
        # What is made in a turn is needed in it alone.
        or any(everywhere.count(name) != within.count(name) for name in turn_by_turn)
        or not {"i", *locals_.values()}.isdisjoint(everywhere)
        or any(hasattr(part.module, name) for name in attributes.values())
        or any(_taken(part, names, name) for names, name in attributes.items())
    ):
        return None
    part.lists.update({name: names for names, name in attributes.items()})
    body = [_Rolled({names[0]: name for names, name in lists.items()}).visit(_copy(s)) for s in blocks[0]]
    count = ast.Call(ast.Name("range", ast.Load()), [ast.Constant(len(blocks))], [])
    loop = ast.For(ast.Name("i", ast.Store()), count, body, [], lineno=blocks[0][0].lineno)
    loop.end_lineno = blocks[-1][-1].end_lineno
    return loop


def _taken(part: Part, names: tuple[str, ...], name: str) -> bool:
    """Whether another list has this name, or one of these attributes."""
    return any(
        (listed == name) != (elements == names) or (elements != names and not set(elements).isdisjoint(names))
        for listed, elements in part.lists.items()
    )


class _Rolled(ast.NodeTransformer):
    """The first turn's names, as the loop has them."""

    def __init__(self, names: dict[str, str]) -> None:
        self.names = names

    def visit_Name(self, node: ast.Name) -> ast.Name:
        return ast.Name(self.names.get(node.id, node.id), node.ctx)

    def visit_Attribute(self, node: ast.Attribute) -> ast.expr:
        name = own_attribute(node)
        found = self.names.get(f"self.{name}")
        if found is None:
            return node
        listed = ast.Attribute(node.value, found.removeprefix("self."), ast.Load())
        return ast.Subscript(listed, ast.Name("i", ast.Load()), node.ctx)


class _Elements(ast.NodeTransformer):
    def __init__(self, part: Part) -> None:
        self.places = {
            name: (array, place) for array, names in part.lists.items() for place, name in enumerate(names)
        }

    def visit_Attribute(self, node: ast.Attribute) -> ast.expr:
        name = own_attribute(node)
        if name not in self.places:
            return node
        array, place = self.places[name]
        return ast.Subscript(ast.Attribute(node.value, array, ast.Load()), ast.Constant(place), node.ctx)


def _names(node: ast.AST) -> list[str]:
    """Local names and attributes of self, in their order."""
    attribute = own_attribute(node)
    if attribute is not None:
        return [f"self.{attribute}"]
    if isinstance(node, ast.Name):
        return [node.id]
    return [name for child in ast.iter_child_nodes(node) for name in _names(child)]


def _locals(node: ast.AST) -> list[str]:
    return [name.id for name in ast.walk(node) if isinstance(name, ast.Name)]


def _is_attribute(name: str) -> bool:
    return name.startswith("self.")


def _blank(node: ast.AST) -> str:
    """The statement without its names."""
    return re.sub(r"(id|attr)='\w+'", "", ast.dump(node))


def _numbered(first: str, later: str, turns: int) -> int | None:
    """Which of its numbers tells `later` from `first`, if one does, by `turns`."""
    a, b = re.split(r"(\d+)", first), re.split(r"(\d+)", later)
    differing = [i for i in range(min(len(a), len(b))) if a[i] != b[i]]
    if len(a) != len(b) or len(differing) != 1 or differing[0] % 2 == 0:
        return None
    return differing[0] if int(b[differing[0]]) - int(a[differing[0]]) == turns else None


def _without_number(first: str, second: str) -> str:
    pieces = re.split(r"(\d+)", first)
    del pieces[_numbered(first, second, 1) or 0]
    return re.sub("__+", "_", "".join(pieces)).rstrip("_")


def _bare(names: tuple[str, ...]) -> tuple[str, ...]:
    return tuple(name.removeprefix("self.") for name in names)


def _copy(node: ast.stmt) -> ast.stmt:
    copied = ast.parse(ast.unparse(node)).body[0]
    # The line counts: comments are found by it.
    return ast.copy_location(copied, node)
