"""A step written out: lists number by number, loops turn by turn, no branch that a constant decides.

    for i in range(len(self.r)):                  h = play(s, self.r_0, self.h_0)
        h = play(s, self.r[i], self.h[i])         self.h_0 = h
        self.h[i] = h                             h = play(s, self.r_1, self.h_1)
                                                  self.h_1 = h

TorchScript reads it in a third of the time (`benchmarks/step_latency.py`): constants are in its code, and
what a compensator does not have costs nothing. The operations, and their order, are the same.
"""

import ast
import hashlib
import linecache
import sys
from typing import cast

from torch import nn

from torchpi.control.direct_inverse import DirectInverseStream
from torchpi.export.parts import Part, WriteOut, own_attribute


def written_out(stream: nn.Module) -> nn.Module:
    """The stream with every direct inverse in it written out; it is changed itself."""
    for name, child in stream.named_children():
        setattr(stream, name, written_out(child))
    return _module(stream) if isinstance(stream, DirectInverseStream) else stream


def _module(stream: DirectInverseStream) -> nn.Module:
    """A module of a class of its own, with the attributes of the stream; its text stays readable."""
    base = type(stream).__mro__[1]
    methods = [name for name, one in vars(type(stream)).items() if callable(one) and name != "__init__"]
    part, write_out = Part((), stream, "TorchScript"), _Numbers(stream)
    trees = (ast.fix_missing_locations(write_out.visit(part.method(name).tree)) for name in methods)
    bodies = "\n\n".join(map(ast.unparse, trees))
    source = f"class WrittenOut({base.__name__}):\n\n" + "\n".join(
        "    " + line for line in bodies.splitlines()
    )
    # By its content, so that equal compensators leave equal files.
    filename = f"<compensator step {hashlib.sha256(source.encode()).hexdigest()[:16]}>"
    # TorchScript reads a function's text through linecache, as tracebacks and debuggers do.
    linecache.cache[filename] = (len(source), None, source.splitlines(True), filename)
    known = vars(sys.modules[type(stream).__module__])
    namespace = {name: value for name, value in known.items() if not name.startswith("__")}
    exec(compile(source, filename, "exec"), namespace)
    found = cast(nn.Module, object.__new__(namespace["WrittenOut"]))
    for name, value in vars(stream).items():
        numbers = {f"{name}_{i}": one for i, one in enumerate(value)} if isinstance(value, list) else {}
        vars(found).update(numbers or {name: value})
    return found


class _Numbers(WriteOut):
    """Every loop turn by turn, every list number by number."""

    def chooses(self, variable: str, loop: ast.For) -> bool:
        return True

    def visit_Subscript(self, node: ast.Subscript) -> ast.AST:
        name = own_attribute(node.value)
        if name is None:
            return node
        return ast.Attribute(ast.Name("self", ast.Load()), f"{name}_{self.number(node.slice)}", node.ctx)
