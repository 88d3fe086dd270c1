"""Mutation test of the judge, the decision and the intervals: which small errors does no test notice?

One thing at a time is changed: a comparison is negated or its boundary included or excluded; a constant is
changed; a sign, an `and` or a condition is replaced or dropped. Each mutant is a module in memory, in a
process of its own that runs the tests guarding the file; the files themselves are not changed.
"""

import argparse
import ast
import contextlib
import importlib
import importlib.util
import os
import sys
import time
from collections.abc import Iterator, Sequence
from copy import deepcopy
from importlib.machinery import SourceFileLoader
from pathlib import Path
from types import CodeType

# Imported here once for all forked processes.
import hypothesis  # noqa: F401
import pytest
import torch  # noqa: F401

ROOT = Path(__file__).parents[1]
GUARDS = {  # each module, and the tests that must notice its mutants
    **{
        f"concealed.judging.{name}": tuple(
            f"benchmarks/proof/test_{t}.py" for t in ("judge", "figures", "injected")
        )
        for name in ("grade", "summary", "calibration", "proportions")
    },
    "torchpi.diagnosis.own_signal": ("diagnosis/test_posterior.py",),
    "torchpi.diagnosis.posterior": ("diagnosis/test_posterior.py",),
    "torchpi.diagnosis.decide": ("diagnosis/test_decide.py",),
    "torchpi.diagnosis.intervals": ("diagnosis/test_intervals.py",),
}
NEGATED: dict[type, type[ast.cmpop]] = {
    ast.Lt: ast.GtE, ast.GtE: ast.Lt, ast.Gt: ast.LtE, ast.LtE: ast.Gt, ast.Eq: ast.NotEq,
    ast.NotEq: ast.Eq, ast.In: ast.NotIn, ast.NotIn: ast.In, ast.Is: ast.IsNot, ast.IsNot: ast.Is,
}  # fmt: skip
BOUNDARY: dict[type, type[ast.cmpop]] = {
    ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt,
}  # fmt: skip
ARITHMETIC: dict[type, type[ast.operator]] = {
    ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult, ast.Pow: ast.Mult,
}  # fmt: skip
PYTEST = ("-x", "-q", "-p", "no:cacheprovider", "-o", "addopts=", "--assert=plain")
LIMIT_S = 300.0  # a mutant whose tests take longer than they ever should counts as noticed


class Mutated(SourceFileLoader):
    """Loads a module from a changed tree, and leaves no compiled file."""

    def __init__(self, name: str, path: str, tree: ast.Module) -> None:
        super().__init__(name, path)
        self.tree = tree

    def get_code(self, fullname: str) -> CodeType:
        return compile(self.tree, self.path, "exec")

    def find_spec(self, name: str, path: object = None, target: object = None) -> object:
        return importlib.util.spec_from_loader(name, self) if name == self.name else None


def variants(node: ast.AST) -> Iterator[tuple[str, ast.AST]]:
    """Yield the variants of an expression or a statement, each with the name of the change."""
    match node:
        case ast.Constant(value=bool() as value):
            yield "constant", ast.Constant(not value)
        case ast.Constant(value=int() | float() as value):
            yield "constant", ast.Constant(2 * value + 1)
        case ast.Compare(left=left, ops=[op], comparators=[right]):
            for kind, table in (("negated", NEGATED), ("boundary", BOUNDARY)):
                if type(op) in table:
                    yield kind, ast.Compare(left, [table[type(op)]()], [right])
        case ast.BinOp(left=left, op=op, right=right) if type(op) in ARITHMETIC:
            yield "operator", ast.BinOp(left, ARITHMETIC[type(op)](), right)
            yield "term dropped", left
        case ast.BoolOp(op=op, values=values):
            yield "and, or", ast.BoolOp(ast.Or() if isinstance(op, ast.And) else ast.And(), values)
            for i in range(len(values)):
                rest = values[:i] + values[i + 1 :]
                yield "condition dropped", rest[0] if len(rest) == 1 else ast.BoolOp(op, rest)
        case ast.UnaryOp(op=ast.Not() | ast.USub(), operand=operand):
            yield "sign dropped", operand
        case ast.Call(func=ast.Name(id="min" | "max" as name), args=[first, _, *_] as arguments):
            yield "bound dropped", first
            other = ast.Name("max" if name == "min" else "min", ast.Load())
            yield "min, max", ast.Call(other, arguments, node.keywords)
        case ast.comprehension(ifs=[_, *_] as ifs):
            for i in range(len(ifs)):
                yield (
                    "condition dropped",
                    ast.comprehension(node.target, node.iter, ifs[:i] + ifs[i + 1 :], node.is_async),
                )
        case ast.If(orelse=[]):
            yield "never", ast.If(ast.Constant(False), node.body, [])


def places(node: ast.AST) -> Iterator[tuple[ast.AST, str, int | None]]:
    """Yield the places for a variant: owner, field, and index in it. Types and messages are skipped."""
    for name, value in ast.iter_fields(node):
        if name in ("annotation", "returns", "type_params") or isinstance(node, ast.JoinedStr | ast.Raise):
            continue
        for i, child in enumerate(value if isinstance(value, list) else [value]):
            if isinstance(child, ast.AST):
                yield node, name, i if isinstance(value, list) else None
                yield from places(child)


def mutants(source: str) -> Iterator[tuple[str, ast.Module]]:
    """Yield each mutant of a module, described by its line, the change, and the code before and after it."""
    tree = ast.parse(source)
    for k, (owner, name, i) in enumerate(places(tree)):
        held = getattr(owner, name)
        for kind, new in variants(held if i is None else held[i]):
            copy = deepcopy(tree)
            owner_, *_ = next(p for n, p in enumerate(places(copy)) if n == k)
            if i is None:
                setattr(owner_, name, new)
            else:
                getattr(owner_, name)[i] = new
            old = held if i is None else held[i]
            line = getattr(old, "lineno", None) or old.target.lineno
            words = [ast.unparse(one).splitlines()[0].strip() for one in (old, new)]
            yield f"{line}: {kind}: {words[0]}  ->  {words[1]}", ast.fix_missing_locations(copy)


def noticed(module: str, path: str, tree: ast.Module | None, tests: Sequence[str]) -> bool:
    """Whether a test fails, or never ends, in a process in which this tree is the module."""
    child = os.fork()
    if child == 0:
        with open(os.devnull, "w") as nowhere:
            os.dup2(nowhere.fileno(), 1)
            os.dup2(nowhere.fileno(), 2)
        package = module.rpartition(".")[0] or module
        for name in [name for name in sys.modules if name.startswith(package)]:
            del sys.modules[name]
        if tree is not None:
            sys.meta_path.insert(0, Mutated(module, path, tree))
        code = 1
        with contextlib.suppress(BaseException):
            code = pytest.main([*PYTEST, *tests])
        os._exit(code != 0)
    begun = time.monotonic()
    while time.monotonic() - begun < LIMIT_S:
        done, status = os.waitpid(child, os.WNOHANG)
        if done:
            return status != 0
        time.sleep(0.02)
    os.kill(child, 9)
    os.waitpid(child, 0)
    return True


def survivors(module: str, tests: Sequence[str]) -> Iterator[tuple[str, bool]]:
    """Yield each mutant of a module, and whether no test noticed it.

    Raises:
        SystemExit: A test fails without any change.
    """
    found = importlib.util.find_spec(module)
    assert found is not None and found.origin is not None
    importlib.import_module(module)  # loads its libraries once, for all forked processes
    if noticed(module, found.origin, None, tests):
        raise SystemExit(f"{module}: its tests fail as it stands")
    for what, tree in mutants(Path(found.origin).read_text()):
        yield what, not noticed(module, found.origin, tree, tests)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("modules", nargs="*", help=f"ends of names: {', '.join(GUARDS)}; all without")
    parser.add_argument("--verbose", action="store_true", help="show what was noticed as well")
    given = parser.parse_args()
    sys.path[:0] = [str(ROOT), str(ROOT / "benchmarks" / "proof")]
    os.environ["PYTEST_DISABLE_PLUGIN_AUTOLOAD"] = (
        "1"  # plugins that no guard needs would take longer to load than the tests run
    )
    for module, guards in GUARDS.items():
        if given.modules and not module.endswith(tuple(given.modules)):
            continue
        count = left = 0
        for what, survives in survivors(module, [str(ROOT / "tests" / guard) for guard in guards]):
            count, left = count + 1, left + survives
            if survives or given.verbose:
                print(f"{module}:{what}{'' if survives else '  (noticed)'}", flush=True)
        print(f"{module}: {count} mutants, {left} that no test notices", flush=True)


if __name__ == "__main__":
    main()
