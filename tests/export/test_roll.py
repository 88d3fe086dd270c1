"""Loops are put back only where they do the same."""

import ast

import pytest
from torch import nn

from torchpi.export.parts import Function, Part
from torchpi.export.roll import roll


def rolled(text: str) -> str:
    """The statements after rolling, in a part whose attributes are those that they name."""
    tree = ast.parse("def step(self, x):\n" + "\n".join(f"    {line}" for line in text.splitlines())).body[0]
    assert isinstance(tree, ast.FunctionDef)
    module = nn.Module()
    for node in ast.walk(tree):
        if isinstance(node, ast.Attribute):
            setattr(module, node.attr, 0.5)
    part = Part((), module, "C")
    return "\n".join(ast.unparse(statement) for statement in roll(part, Function(tree, {}, {})).body)


def test_numbered_statements_become_a_loop() -> None:
    lines = [f"h{k} = f(x, self.r_{k}, self.h{k})\nself.h{k} = h{k}\nu = u + h{k}" for k in range(4)]
    assert rolled("\n".join(["u = 0.0", *lines, "return u"])) == (
        "u = 0.0\nfor i in range(4):\n    h = f(x, self.r[i], self.h[i])\n"
        "    self.h[i] = h\n    u = u + h\nreturn u"
    )


def test_what_the_loop_lists_is_listed_elsewhere_too() -> None:
    text = "y = self.a0 + self.a1 + self.a2\n" + "\n".join(f"self.a{k} = x" for k in range(3))
    assert rolled(text).startswith("y = self.a[0] + self.a[1] + self.a[2]\nfor i in range(3):")


@pytest.mark.parametrize(
    "text",
    [
        # A chain: each turn needs the one before.
        "x1 = f(x0)\nx2 = f(x1)\nx3 = f(x2)",
        # A delay line, whose order counts.
        "self.y3 = self.y2\nself.y4 = self.y3\nself.y5 = self.y4",
        # One name that counts at one place and stays at another.
        "u = g(a0, a0)\nu = g(a1, a0)\nu = g(a2, a0)",
        # Made in a turn, needed after the loop.
        "p0 = f(x)\np1 = f(x)\np2 = f(x)\nreturn p0 + p1 + p2",
        # Two turns are no loop.
        "self.a0 = x\nself.a1 = x",
        # Numbers that do not follow each other.
        "self.a0 = x\nself.a2 = x\nself.a4 = x",
        # The name is another attribute's.
        "self.a0 = x\nself.a1 = x\nself.a2 = x\nself.a = x",
    ],
)
def test_what_would_not_be_the_same_stays(text: str) -> None:
    assert rolled(text) == text


def test_attributes_are_in_one_list_only() -> None:
    rows = "\n".join(f"self.a_0_{k} = x" for k in range(3))
    columns = "\n".join(f"self.a_{k}_2 = x" for k in range(3))
    assert rolled(f"{rows}\nx = f(x)\n{columns}").count("for i in") == 1
