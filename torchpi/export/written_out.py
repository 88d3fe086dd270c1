"""Unroll a step: lists become single numbers, loops are unrolled, and branches on constants disappear.

    for i in range(len(self.r)):                  h = play(s, self.r_0, self.h_0)
        h = play(s, self.r[i], self.h[i])         self.h_0 = h
        self.h[i] = h                             h = play(s, self.r_1, self.h_1)
                                                  self.h_1 = h

TorchScript reads the unrolled step in a third of the time (`benchmarks/step_latency.py`): constants are in
the code, and features that a compensator lacks cost nothing. The operations and their order are the same.
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
    """Unroll every direct inverse inside the stream, which is modified in place, and return the result."""
    for name, child in stream.named_children():
        setattr(stream, name, written_out(child))
    return _module(stream) if isinstance(stream, DirectInverseStream) else stream


def _module(stream: DirectInverseStream) -> nn.Module:
    """Return a module of a generated class with the attributes of the stream; its source stays readable."""
    base = type(stream).__mro__[1]
    methods = [name for name, one in vars(type(stream)).items() if callable(one) and name != "__init__"]
    part, write_out = Part((), stream, "TorchScript"), _Numbers(stream)
    trees = (ast.fix_missing_locations(write_out.visit(part.method(name).tree)) for name in methods)
    bodies = "\n\n".join(map(ast.unparse, trees))
    source = f"class WrittenOut({base.__name__}):\n\n" + "\n".join(
        "    " + line for line in bodies.splitlines()
    )
    # Named by a hash of the source, so that equal compensators give equal files.
    filename = f"<compensator step {hashlib.sha256(source.encode()).hexdigest()[:16]}>"
    # TorchScript reads the source of a function through linecache, as tracebacks and debuggers do.
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
    """Unrolls every loop and replaces every list element by a single number."""

    def chooses(self, variable: str, loop: ast.For) -> bool:
        return True

    def visit_Subscript(self, node: ast.Subscript) -> ast.AST:
        name = own_attribute(node.value)
        if name is None:
            return node
        return ast.Attribute(ast.Name("self", ast.Load()), f"{name}_{self.number(node.slice)}", node.ctx)
