"""Check, before any of its code runs, that a TorchScript file holds only what torchpi writes.

TorchScript is a programming language whose operators read and write files, and a file may run code while it
is loaded (`__setstate__`). So a file is checked in two steps. First its archive is read as text, without
torch; only the parts, methods, statements and calls that torchpi writes pass. Then torch compiles it, which
runs none of the accepted code, and the compiled graph is compared with a list of permitted typed operators:
on numbers, on lists of numbers, and the few on tensors that `block` needs.
"""

import ast
import itertools
import math
import pickletools
import re
import zipfile
from pathlib import Path
from typing import Any

from torchpi.errors import ArtifactError
from torchpi.files import check_archive
from torchpi.recordings.identity import is_sha256

LARGEST_BYTES = 2**26
RECORDINGS_PART = "extra/recordings_sha256"
"""The part of the archive that identifies the recordings a compensator was trained on."""
LONGEST_LOOP = 1024  # iterations of a loop with a constant count
LONGEST_LIST = 4096
DEEPEST_LOOPS = {"reset": 2, "step": 2}  # nested loops; these two run while a file is loaded
METHODS = ("reset", "reset_at", "reset_at_voltage", "step", "block")

_PARTS = re.compile(
    r"[^/]+/(data\.pkl|constants\.pkl|extra/recordings_sha256|version|byteorder|\.data/serialization_id"
    r"|code/__torch__/[\w./]+\.py(\.debug_pkl)?)"
)
_ANNOTATIONS = re.compile(r"(List\[)?(float|int|bool)\]?|__torch__[\w.]+")
_STATEMENTS = (
    ast.Module, ast.ClassDef, ast.FunctionDef, ast.arguments, ast.arg, ast.AnnAssign, ast.Assign, ast.For,
    ast.If, ast.Pass, ast.Return, ast.Expr, ast.Call, ast.Attribute, ast.Name, ast.Subscript, ast.Constant,
    ast.List, ast.Tuple, ast.UnaryOp, ast.USub, ast.Load, ast.Store,
)  # fmt: skip
_CALLS = frozenset(
    "float getattr range ops.prim.abs ops.prim.max ops.prim.min torch.__derive_index torch.__not__ "
    "torch.__range_length torch._set_item torch.add torch.div torch.empty_like torch.eq torch.fill_ torch.ge "
    "torch.gt torch.le torch.len torch.lt torch.mul torch.ne torch.neg torch.remainder torch.select "
    "torch.sub".split()
)
_OPCODES = frozenset(
    "APPENDS BINFLOAT BINGET BININT BININT1 BININT2 BINPUT BINUNICODE BUILD EMPTY_DICT EMPTY_LIST "
    "EMPTY_TUPLE GLOBAL LONG1 LONG_BINGET LONG_BINPUT MARK NEWFALSE NEWOBJ NEWTRUE PROTO REDUCE SETITEMS "
    "STOP TUPLE TUPLE1 TUPLE2 TUPLE3".split()
)
_GLOBALS = ("torch.jit._pickle build_doublelist", "torch.jit._pickle build_intlist")
_SCHEMAS = frozenset(
    """
    aten::__derive_index(int index, int start, int step) -> int
    aten::__not__(bool self) -> bool
    aten::__range_length(int lo, int hi, int step) -> int
    aten::add.float(float a, float b) -> float
    aten::add.int(int a, int b) -> int
    aten::div.float(float a, float b) -> float
    aten::eq.float(float a, float b) -> bool
    aten::eq.int(int a, int b) -> bool
    aten::ge.float(float a, float b) -> bool
    aten::ge.int(int a, int b) -> bool
    aten::gt.float(float a, float b) -> bool
    aten::gt.int(int a, int b) -> bool
    aten::le.float(float a, float b) -> bool
    aten::le.int(int a, int b) -> bool
    aten::len.Tensor(Tensor t) -> int
    aten::len.t(t[] a) -> int
    aten::lt.float(float a, float b) -> bool
    aten::lt.int(int a, int b) -> bool
    aten::mul.float(float a, float b) -> float
    aten::ne.float(float a, float b) -> bool
    aten::ne.int(int a, int b) -> bool
    aten::neg.float(float a) -> float
    aten::remainder.int(int a, int b) -> int
    aten::sub.float(float a, float b) -> float
    aten::sub.int(int a, int b) -> int
    prim::abs.float(float a) -> float
    prim::max.float(float a, float b) -> float
    prim::min.float(float a, float b) -> float
    aten::Float.Tensor(Tensor a) -> float
    aten::select.int(Tensor(a) self, int dim, SymInt index) -> Tensor(a)
    aten::fill_.Scalar(Tensor(a!) self, Scalar value) -> Tensor(a!)
    """.strip()
    .replace("    ", "")
    .splitlines()
)
_ON_LISTS = ("aten::__getitem__.t(", "aten::_set_item.t(")
_ON_TENSORS = ("aten::empty_like(",)
_STRUCTURE = frozenset(
    "prim::Constant prim::GetAttr prim::SetAttr prim::If prim::TupleConstruct prim::TupleUnpack".split()
)
_ELEMENTS = ("BINFLOAT", "BININT", "BININT1", "BININT2", "LONG1", "BINGET", "LONG_BINGET")
_NUMBERS = frozenset(("float", "int", "bool", "List[float]", "List[int]"))


def check_file(path: Path) -> None:
    """Check the archive as text.

    Raises:
        ArtifactError: The archive is damaged, or holds something that torchpi does not write.
    """
    check_archive(path, LARGEST_BYTES)
    with zipfile.ZipFile(path) as archive:
        names = archive.namelist()
        if len(set(names)) != len(names):
            _refuse(path, "two parts with the same name")
        if not any("/code/" in name for name in names):
            raise ArtifactError(
                f"{path}: not a TorchScript file, expected a compensator written by 'torchpi export'"
            )
        for name in names:
            if not _PARTS.fullmatch(name):
                _refuse(path, f"a part '{name}'")
            content = archive.read(name)
            if name.endswith(".py"):
                _check_code(path, content)
            elif name.endswith("/" + RECORDINGS_PART) and not is_sha256(content.decode("ascii", "replace")):
                _refuse(path, "an invalid hash of the recordings")
            elif not name.endswith(".debug_pkl") and name.endswith(".pkl"):
                _check_pickle(path, content)


def check_graph(path: Path, loaded: Any) -> None:
    """Compare the compiled methods with the list of permitted operators.

    Raises:
        ArtifactError: A method contains an operator, a type or a loop that torchpi does not write.
    """
    module = loaded._c
    names = set(module._method_names())
    if names != set(METHODS):
        missing = ", ".join(sorted(set(METHODS) - names))
        raise ArtifactError(
            f"{path}: found a TorchScript file without {missing}, expected a compensator written by "
            "'torchpi export' of this version"
        )
    for name in METHODS:
        _check_block(path, module._get_method(name).graph, DEEPEST_LOOPS.get(name, 3), name == "block")


def _check_code(path: Path, content: bytes) -> None:
    try:
        tree = ast.parse(content.decode("utf-8"))
    except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
        raise ArtifactError(f"{path}: found code that cannot be read, expected a whole file") from error
    if not all(isinstance(node, ast.ClassDef) for node in tree.body):
        _refuse(path, "code outside its classes")
    for node in ast.walk(tree):
        match node:
            case ast.FunctionDef(name=name) if name not in METHODS:
                _refuse(path, f"a method '{name}'")
            case ast.AnnAssign(annotation=kind) if not _ANNOTATIONS.fullmatch(ast.unparse(kind)):
                _refuse(path, f"an attribute of type '{ast.unparse(kind)[:40]}'")
            case ast.Call(func=function) if (called := ast.unparse(function)) not in _CALLS or node.keywords:
                _refuse(path, f"a call of '{called[:40]}'")
            case _ if not isinstance(node, _STATEMENTS):
                _refuse(path, f"a statement '{type(node).__name__}'")


def _check_pickle(path: Path, content: bytes) -> None:
    """Check that a pickle holds only plain values and lists of finite numbers of bounded length."""
    elements = 0
    try:
        for opcode, argument, _ in pickletools.genops(content):
            if opcode.name not in _OPCODES:
                _refuse(path, f"a pickle with {opcode.name}")
            if opcode.name == "GLOBAL" and not (
                argument in _GLOBALS or str(argument).startswith("__torch__.")
            ):
                _refuse(path, f"a pickle with '{str(argument)[:40]}'")
            if isinstance(argument, float) and not math.isfinite(argument):
                _refuse(path, f"the number {argument}")
            elements = 0 if opcode.name in ("MARK", "APPENDS") else elements + (opcode.name in _ELEMENTS)
            if elements > LONGEST_LIST:
                _refuse(path, f"a list of more than {LONGEST_LIST} numbers")
    except ArtifactError:
        raise
    except Exception as error:  # arbitrary bytes can make pickletools raise any exception
        raise ArtifactError(f"{path}: found a damaged pickle, expected a whole file") from error


def _check_block(path: Path, block: Any, deepest: int, has_tensors: bool) -> None:
    for node in block.nodes():
        kind, schema = node.kind(), str(node.schema())
        if kind == "prim::Loop":
            if deepest == 0 or not _is_short(node):
                _refuse(path, "a loop that may be endless")
        elif kind in _STRUCTURE:
            types = [str(value.type()) for value in node.outputs()]
            if not all(_is_known(one, kind, has_tensors) for one in types):
                _refuse(path, f"{kind} of {types[0][:40]}")
        elif not (
            schema in _SCHEMAS
            or (schema.startswith(_ON_LISTS) and str(next(node.inputs()).type()).startswith("List["))
            or (schema.startswith(_ON_TENSORS) and has_tensors)
        ):
            _refuse(path, f"the operator {kind}")
        for inner in node.blocks():
            _check_block(path, inner, deepest - (kind == "prim::Loop"), has_tensors)


def _is_known(type_: str, kind: str, has_tensors: bool) -> bool:
    if kind == "prim::GetAttr" and type_.startswith("__torch__."):
        return True
    if kind == "prim::If" and has_tensors and type_ == "Tensor":
        return True
    return type_ in _NUMBERS or type_ == "NoneType" or bool(re.fullmatch(r"Tuple\[(float(, )?)+\]", type_))


def _is_short(loop: Any) -> bool:
    """Whether the loop runs to its end over a constant number of iterations, a list or a tensor."""
    turns, condition = itertools.islice(loop.inputs(), 2)
    goes_on = next(next(loop.blocks()).outputs())
    return _constant(condition) == 1 and _constant(goes_on) == 1 and _is_bounded(turns)


def _is_bounded(value: Any) -> bool:
    kind = value.node().kind()
    if kind == "aten::len":
        return True
    if kind == "aten::__range_length":
        return all(map(_is_bounded, value.node().inputs()))
    number = _constant(value)
    return number is not None and abs(number) <= LONGEST_LOOP


def _constant(value: Any) -> float | None:
    if value.node().kind() != "prim::Constant":
        return None
    found = value.toIValue()
    return found if isinstance(found, int | float) else None


def _refuse(path: Path, found: str) -> None:
    raise ArtifactError(f"{path}: found {found}, expected only a compensator of 'torchpi export'")
