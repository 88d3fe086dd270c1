"""The compensator as C99: a header, a source, and a program that tests them on the target.

No heap, no library, and states in a struct, so that several run side by side. The equations are those of
the deployed step, translated (`c_step.py`). In a float build only what forms the rate stays double.
"""

import re
from functools import partial
from pathlib import Path

import torchpi
from torchpi.errors import ArtifactError
from torchpi.export.c_expression import DOUBLE, KEYWORDS, REAL, literal
from torchpi.export.c_selftest import selftest
from torchpi.export.c_step import StepInC, ascii_only, wrapped
from torchpi.export.deployable import Deployable
from torchpi.export.formats import Files
from torchpi.export.parts import Part, take_apart
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
    """NAME.h, NAME.c and NAME_selftest.c, NAME being the last part of `output`.

    Raises:
        ArtifactError: NAME is not free to use in C, a part has no C form, or a number is not finite.
    """
    texts = c_source(compensator, output.name, reference_filter)
    return {output.parent / file: partial(_write, text) for file, text in texts.items()}


def c_source(
    compensator: Deployable, name: str, reference_filter: ReferenceFilter | None = None
) -> dict[str, str]:
    """The three files, by their names.

    Raises:
        ArtifactError: As `c_files`.
    """
    check_name(name)
    part = take_apart(compensator.stream(reference_filter), "C")
    step = StepInC(part, name, {f"{name}_{word}" for word in _PUBLIC})
    return {
        f"{name}.h": header(part, step),
        f"{name}.c": source(step),
        f"{name}_selftest.c": selftest(compensator.stream(reference_filter), name),
    }


def check_name(name: str) -> None:
    """Whether names in C may begin with it.

    Raises:
        ArtifactError: They may not.
    """
    if not re.fullmatch(r"[A-Za-z][A-Za-z0-9_]*", name, re.ASCII) or name in KEYWORDS | _STANDARD_HEADERS:
        raise ArtifactError(
            f"name for C: found '{name}', expected letters, digits and _ that begin with a letter, and no "
            "word or header of C; give --output another last part"
        )


def header(part: Part, step: StepInC) -> str:
    name = step.name
    takes = "the reference y_r" if part.value("has_reference_filter") else "the desired displacement"
    period, preview = part.value("sample_period_s"), part.value("preview")
    low, high = part.value("min_voltage_v"), part.value("max_voltage_v")
    low_um, high_um = part.value("least_accepted_um"), part.value("largest_accepted_um")
    longest_um = part.value("largest_step_um")
    return f"""\
/* {name}: voltage for a piezo stage, without feedback. Written by torchpi {torchpi.__version__}; do not edit.
 *
 *   {name}_state state;
 *   {name}_reset(&state);
 *   every {period:g} s:  u = {name}_step(&state, yd);
 *
 * yd is {takes} in um, {preview} samples ahead of the voltage u in V. Each state is independent of every
 * other. Inputs beyond {low_um:.6g} ... {high_um:.6g} um, jumps of more than {longest_um:.4g} um that the
 * next samples do not confirm, inf and NaN are held, and count in state.held_inputs: the last accepted one
 * stands in. state.outside_range counts inputs beyond the trained range or rate, state.limited_outputs
 * voltages that the limits changed.
 *
 * Compile with {_FLAGS}: without fused multiply-add the numbers are those of Python to
 * the last bit, which {name}_selftest.c tests. With {name}_FLOAT32 defined, for every file that includes this
 * one, it computes in float, but for the rate, which is formed in double: the difference of two float samples
 * is too coarse.
 */
#ifndef {name}_H
#define {name}_H

#include <stdbool.h>
#include <stddef.h>

#define {name}_SAMPLE_PERIOD_S {period!r} /* s */
#define {name}_PREVIEW {preview} /* samples that yd is ahead of u */
#define {name}_MIN_VOLTAGE_V {low!r} /* V, output limits, inside */
#define {name}_MAX_VOLTAGE_V {high!r} /* V */
#define {name}_HAS_REFERENCE_FILTER {int(bool(part.value("has_reference_filter")))} /* of eq. 14, inside */

#ifdef {name}_FLOAT32
typedef float {name}_real;
/* Names of their own, so that files compiled with and without the macro do not link with each other. */
#define {name}_reset {name}_reset_float32
#define {name}_reset_at {name}_reset_at_float32
#define {name}_reset_at_voltage {name}_reset_at_voltage_float32
#define {name}_step {name}_step_float32
#define {name}_block {name}_block_float32
#else
typedef double {name}_real;
#endif

typedef struct {{
{_members(step)}
}} {name}_state;

#ifdef __cplusplus
extern "C" {{
#endif

/* The de-energised state; call it before the first step. */
void {name}_reset({name}_state *self);

/* Instead of reset, for a stage that stands at yd, in um: returns the voltage that keeps it there, in V. */
double {name}_reset_at({name}_state *self, double yd);

/* Instead of reset, for a stage that stands under voltage_v: returns the displacement, in um. */
double {name}_reset_at_voltage({name}_state *self, double voltage_v);

/* One sample: um to V. */
double {name}_step({name}_state *self, double yd);

/* n samples, the same numbers as n steps; u may be yd. */
void {name}_block({name}_state *self, const double *yd, double *u, size_t n);

#ifdef __cplusplus
}}
#endif

#endif
"""


def source(step: StepInC) -> str:
    name = step.name
    results = "".join(
        f"typedef struct {{ {' '.join(f'{kind} v{i};' for i, kind in enumerate(kinds))} }} {result};\n"
        for result, kinds in step.results.items()
    )
    sections = [
        f"/* {name}: see {name}.h. Equations by their numbers in Qin et al., IEEE/ASME Trans. Mechatronics\n"
        " * 18(3), 2013. Written by torchpi; do not edit. */\n"
        f'#include "{name}.h"\n\n'
        "#ifdef __clang__ /* which fuses multiply and add unless told not to */\n"
        "#pragma STDC FP_CONTRACT OFF\n#endif\n\n"
        f"typedef {name}_real real;\n{results}",
        _constants(step),
        *(_helper(helper, kind) for helper, kind in step.helpers.items()),
        *step.functions.values(),
        _reset(step),
        f"""\
void {name}_block({name}_state *self, const double *yd, double *u, size_t n)
{{
    for (size_t i = 0; i < n; i++) {{
        u[i] = {name}_step(self, yd[i]);
    }}
}}
""",
    ]
    return "\n".join(section for section in sections if section)


def _members(step: StepInC) -> str:
    lines: list[str] = []
    open_: tuple[str, ...] = ()
    # Members of one part stand together, in one struct.
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
    # Part by part, and in the order of its `__init__`.
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
    return "\n".join(lines).lstrip("\n") + "\n"


def _helper(name: str, kind: str) -> str:
    zero = literal(0.0, kind)
    what = name.removesuffix(f"_{DOUBLE}")
    # Python's max, min and abs.
    arguments = f"{kind} a, {kind} b" if what != "magnitude" else f"{kind} a"
    value = {"larger": "b > a ? b : a", "smaller": "b < a ? b : a"}.get(what, f"a > {zero} ? a : {zero} - a")
    return f"static {kind} {name}({arguments})\n{{\n    return {value};\n}}\n"


def _reset(step: StepInC) -> str:
    lines = []
    for path, (kind, value) in step.states.items():
        place = "self->" + ".".join(path)
        if isinstance(value, list) and len(set(value)) == 1:
            lines.append(f"    for (size_t i = 0; i < {len(value)}; i++) {{")
            lines.append(f"        {place}[i] = {literal(value[0], kind)};")
            lines.append("    }")
        elif isinstance(value, list):
            lines += [f"    {place}[{i}] = {literal(v, kind)};" for i, v in enumerate(value)]
        elif isinstance(value, bool):
            lines.append(f"    {place} = {str(value).lower()};")
        else:
            lines.append(f"    {place} = {value if isinstance(value, int) else literal(value, kind)};")
    body = "\n".join(lines)
    return f"void {step.name}_reset({step.name}_state *self)\n{{\n{body}\n}}\n"


def _write(text: str, path: Path) -> None:
    path.write_text(text, encoding="ascii", newline="\n")
