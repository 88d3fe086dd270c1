"""Every C fragment of docs/controllers.md and the README compiles and runs, with stand-ins if needed."""

import math
import re
from pathlib import Path

import pytest
import torch

from tests.export.c_compiler import FLOAT, built, cc, needs_cc, run
from tests.export.test_torchscript import compensator
from torchpi.export import export_files

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "controllers.md").read_text(encoding="utf-8")
README = (ROOT / "README.md").read_text(encoding="utf-8")
FRAGMENTS = re.findall(r"```c\n(.*?)```", PAGE, re.DOTALL)
SAMPLES = 200

# The part of Simulink's header that our S-function uses.
SIMSTRUC = """\
#include <stddef.h>
typedef double real_T;
typedef int int_T;
typedef struct { int_T width; real_T work[512]; real_T yd, u, period; } SimStruct;
#define SS_DOUBLE 0
#define ssSetNumSFcnParams(S, n) ((void)(S))
#define ssGetNumSFcnParams(S) ((void)(S), 0)
#define ssGetSFcnParamsCount(S) ((void)(S), 0)
#define ssSetNumInputPorts(S, n) ((void)(S), (n) == 1)
#define ssSetNumOutputPorts(S, n) ((void)(S), (n) == 1)
#define ssSetInputPortWidth(S, port, n) ((void)(S))
#define ssSetInputPortRequiredContiguous(S, port, yes) ((void)(S))
#define ssSetInputPortDirectFeedThrough(S, port, yes) ((void)(S))
#define ssSetOutputPortWidth(S, port, n) ((void)(S))
#define ssSetNumSampleTimes(S, n) ((void)(S))
#define ssSetNumDWork(S, n) ((void)(S))
#define ssSetDWorkWidth(S, i, n) ((S)->width = (n))
#define ssSetDWorkDataType(S, i, kind) ((void)(S))
#define ssSetSampleTime(S, i, seconds) ((S)->period = (seconds))
#define ssSetOffsetTime(S, i, seconds) ((void)(S))
#define ssGetDWork(S, i) ((void *)(S)->work)
#define ssGetInputPortRealSignal(S, port) ((const real_T *)&(S)->yd)
#define ssGetOutputPortRealSignal(S, port) (&(S)->u)
"""

# In place of the file that Simulink includes at the end: it runs the block.
CG_SFUN = f"""\
#include <math.h>
#include <stdio.h>
int main(void)
{{
    static SimStruct S;
    mdlInitializeSizes(&S);
    mdlInitializeSampleTimes(&S);
    if (S.width > 512 || S.width * sizeof(real_T) < sizeof(demo_state)) {{
        return 1;
    }}
    mdlInitializeConditions(&S);
    for (int k = 0; k < {SAMPLES}; k++) {{
        S.yd = 2 - 2 * cos(0.1 * (k + demo_PREVIEW));
        mdlOutputs(&S, 0);
        printf("%.17g\\n", S.u);
    }}
    mdlTerminate(&S);
    return S.period == demo_SAMPLE_PERIOD_S ? 0 : 1;
}}
"""

# In place of dSPACE's header: the timer is a loop, and the program ends with it.
BRTENV = f"""\
#include <stdlib.h>
#define init() ((void)0)
#define RTLIB_SRT_ISR_BEGIN() ((void)0)
#define RTLIB_SRT_ISR_END() ((void)0)
#define RTLIB_SRT_START(period, isr) do {{ for (int k = 0; k < {SAMPLES}; k++) isr(); exit(0); }} while (0)
#define RTLIB_BACKGROUND_SERVICE() ((void)0)
"""
BOARD = """\
#include <math.h>
#include <stdio.h>
double desired_um(unsigned long tick);
void write_voltage(double u);
double desired_um(unsigned long tick) { return 2 - 2 * cos(0.1 * (double)tick); }
void write_voltage(double u) { printf("%.17g\\n", u); }
"""

MICROCONTROLLER = f"""\
#include <math.h>
#include <stdint.h>
#include <stdio.h>
double desired_um(uint32_t tick);
void clear_timer_flag(void);
void write_converter(uint16_t code);
void start(void);
void timer_interrupt(void);
double desired_um(uint32_t tick) {{ return 2 - 2 * cos(0.1 * (double)tick); }}
void clear_timer_flag(void) {{}}
void write_converter(uint16_t code) {{ printf("%u\\n", code); }}
int main(void)
{{
    start();
    for (int k = 0; k < {SAMPLES}; k++) timer_interrupt();
    return 0;
}}
"""


def expected() -> list[float]:
    made = compensator()
    yd = [2 - 2 * math.cos(0.1 * (k + made.preview)) for k in range(SAMPLES)]
    return made.stream().block(torch.tensor(yd, dtype=torch.float64)).tolist()


def fragment(which: str) -> str:
    (found,) = [text for text in FRAGMENTS if which in text]
    return found


def test_the_page_has_three_fragments() -> None:
    assert len(FRAGMENTS) == 3


@needs_cc
@pytest.mark.parametrize(
    ("which", "files"),
    [
        ("simstruc.h", {"simstruc.h": SIMSTRUC, "cg_sfun.h": CG_SFUN}),
        ("brtenv.h", {"brtenv.h": BRTENV, "board.c": BOARD}),
    ],
)
def test_fragment_gives_the_voltages_of_the_stream(which: str, files: dict[str, str], tmp_path: Path) -> None:
    export_files(compensator(), tmp_path / "demo", ("c",))
    for name, text in {**files, "fragment.c": fragment(which)}.items():
        (tmp_path / name).write_text(text)
    sources = [tmp_path / name for name in ("fragment.c", "demo.c", *files) if name.endswith(".c")]
    done = run(built(tmp_path / "program", f"-I{tmp_path}", *sources, "-lm"))
    assert done.returncode == 0
    assert [float(line) for line in done.stdout.split()] == expected()


@needs_cc
@pytest.mark.parametrize("flags", [[], ["-Ddemo_FLOAT32"]])
def test_microcontroller_fragment_writes_the_converter_codes(flags: list[str], tmp_path: Path) -> None:
    export_files(compensator(), tmp_path / "demo", ("c",))
    (tmp_path / "fragment.c").write_text(fragment("timer_interrupt"))
    (tmp_path / "board.c").write_text(MICROCONTROLLER)
    # An interrupt handler has no prototype, since no other file calls it.
    assert (
        cc(*flags, *FLOAT, f"-I{tmp_path}", "-c", tmp_path / "fragment.c", "-o", tmp_path / "f.o").returncode
        == 0
    )
    sources = [tmp_path / name for name in ("f.o", "demo.c", "board.c")]
    done = run(built(tmp_path / "program", *flags, f"-I{tmp_path}", *sources, "-lm"))
    codes = [int(line) for line in done.stdout.split()]
    assert all(abs(code - u * 6553.5) <= 1 for code, u in zip(codes, expected(), strict=True))


@needs_cc
def test_readme_c_gives_the_voltage_of_the_stream(tmp_path: Path) -> None:
    export_files(compensator(), tmp_path / "mine", ("c",))
    (text,) = re.findall(r"```c\n(.*?)```", README, re.DOTALL)
    include, _, body = text.partition("\n")
    main = (
        f'{include}\n#include <stdio.h>\nint main(void)\n{{{body}printf("%.17g", voltage);\nreturn 0;\n}}\n'
    )
    (tmp_path / "main.c").write_text(main)
    done = run(built(tmp_path / "program", f"-I{tmp_path}", tmp_path / "main.c", tmp_path / "mine.c"))
    assert float(done.stdout) == compensator().stream().step(1.25)
