"""The compensator as C99: a header, a source, and a program that tests them on the target.

The C code uses neither heap nor library and keeps its states in a struct, so that several instances can run
side by side. The equations are translated from the deployed step (`c_step.py`); the templates in `c/` supply
the surrounding code. In a float build, only the numbers that form the rate stay double.
"""

import re
from collections.abc import Sequence
from pathlib import Path

import torchpi
from torchpi.errors import ArtifactError
from torchpi.export.c_expression import DOUBLE, KEYWORDS, REAL, literal
from torchpi.export.c_selftest import recorded
from torchpi.export.c_step import StepInC, ascii_only, wrapped
from torchpi.export.deployable import Deployable
from torchpi.export.formats import Files, written
from torchpi.export.parts import Part, take_apart
from torchpi.export.templates import rendered
from torchpi.operators.reference_filter import ReferenceFilter

_FLAGS = "-std=c99 -ffp-contract=off -O2"
_PUBLIC = (
    "state", "real", "reset", "reset_at", "reset_at_voltage", "step", "block", "H", "FLOAT32",
    "SAMPLE_PERIOD_S", "PREVIEW", "MIN_VOLTAGE_V", "MAX_VOLTAGE_V", "HAS_REFERENCE_FILTER",
)  # fmt: skip
_STANDARD_HEADERS = frozenset(
    "assert complex ctype errno fenv float inttypes iso646 limits locale math setjmp signal stdarg stdbool "
    "stddef stdint stdio stdlib string tgmath time wchar wctype".split()
)


def c_files(compensator: Deployable, output: Path, reference_filter: ReferenceFilter | None = None) -> Files:
    """Return NAME.h, NAME.c and NAME_selftest.c, where NAME is the last part of `output`.

    Raises:
        ArtifactError: NAME cannot be used in C, a part has no C form, or a number is not finite.
    """
    texts = c_source(compensator, output.name, reference_filter)
    return {output.parent / file: written(text) for file, text in texts.items()}


def c_source(
    compensator: Deployable, name: str, reference_filter: ReferenceFilter | None = None
) -> dict[str, str]:
    """Return the text of the three files by their names.

    Raises:
        ArtifactError: As `c_files`.
    """
    check_name(name)
    part = take_apart(compensator.stream(reference_filter), "C")
    step = StepInC(part, name, {f"{name}_{word}" for word in _PUBLIC})
    context = {
        "name": name,
        "version": torchpi.__version__,
        "flags": _FLAGS,
        "filtered": bool(part.value("has_reference_filter")),
        "period": part.value("sample_period_s"),
        "preview": part.value("preview"),
        "low": part.value("min_voltage_v"),
        "high": part.value("max_voltage_v"),
        "low_um": part.value("least_accepted_um"),
        "high_um": part.value("largest_accepted_um"),
        "longest_um": part.value("largest_step_um"),
        "members": _members(step),
        "constants": _constants(step),
        "results": step.results,
        "helpers": step.helpers,
        "functions": step.functions,
        "states": step.states,
        **recorded(compensator.stream(reference_filter)),
    }
    templates = {f"{name}.h": "step.h", f"{name}.c": "step.c", f"{name}_selftest.c": "selftest.c"}
    return {
        file: rendered(f"c/{template}.j2", context, literal=_literal, table=_table)
        for file, template in templates.items()
    }


def check_name(name: str) -> None:
    """Check that names in C may begin with `name`.

    Raises:
        ArtifactError: Names in C may not begin with `name`, or it is a keyword or a standard header.
    """
    if not re.fullmatch(r"[A-Za-z][A-Za-z0-9_]*", name, re.ASCII) or name in KEYWORDS | _STANDARD_HEADERS:
        raise ArtifactError(
            f"name for C: found '{name}', expected letters, digits and _, beginning with a letter, and no "
            "reserved word or header of C; change the last part of --output"
        )


def _members(step: StepInC) -> str:
    lines: list[str] = []
    open_: tuple[str, ...] = ()
    # Sorted so that the members of one part stand together in one struct.
    for path, (kind, value) in sorted(step.states.items(), key=lambda item: item[0][:-1]):
        owner = path[:-1]
        shared = 0
        while shared < min(len(owner), len(open_)) and owner[shared] == open_[shared]:
            shared += 1
        lines += [
            f"{'    ' * (depth + 1)}}} {open_[depth]};" for depth in range(len(open_) - 1, shared - 1, -1)
        ]
        lines += [f"{'    ' * (depth + 1)}struct {{" for depth in range(shared, len(owner))]
        open_ = owner
        c_type = f"{step.name}_real" if kind == REAL else kind
        length = f"[{len(value)}]" if isinstance(value, list) else ""
        lines.append(f"{'    ' * (len(owner) + 1)}{c_type} {path[-1]}{length};")
    lines += [f"{'    ' * (depth + 1)}}} {open_[depth]};" for depth in range(len(open_) - 1, -1, -1)]
    return "\n".join(lines)


def _constants(step: StepInC) -> str:
    lines: list[str] = []
    part: Part | None = None
    met = list(dict.fromkeys(constant.part.path for constant in step.constants.values()))
    # Sorted by part and, within a part, in the order of its `__init__`.
    constants = sorted(
        step.constants.items(),
        key=lambda item: (met.index(item[1].part.path), item[1].part.place(item[1].attribute)),
    )
    for name, constant in constants:
        if constant.part is not part and constant.part.path:
            lines.append("\n" + wrapped(f"/* {'.'.join(constant.part.path)}: {constant.part.summary} */"))
        elif constant.part is not part:
            lines.append("")
        part = constant.part
        if isinstance(constant.value, list):
            numbers = ", ".join(repr(value) for value in constant.value)
            text = f"static const {constant.type} {name}[{len(constant.value)}] = {{{numbers}}};"
        else:
            number = str(constant.value).lower() if isinstance(constant.value, bool) else repr(constant.value)
            text = f"static const {constant.type} {name} = {number};"
        lines.append(wrapped(text + (f" /* {ascii_only(constant.remark)} */" if constant.remark else "")))
    return "\n".join(lines).lstrip("\n")


def _literal(value: float, kind: str) -> str:
    return literal(value, kind) if kind in (REAL, DOUBLE) else str(value).lower()


def _table(values: Sequence[float]) -> str:
    texts = [value.hex() for value in values]
    return "\n".join(f"    {', '.join(texts[i : i + 4])}," for i in range(0, len(texts), 4))
