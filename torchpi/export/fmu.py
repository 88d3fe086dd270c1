"""The compensator as an FMU for co-simulation (FMI 3.0): the C of `c_source.py` wrapped in the FMI interface.

The FMU holds its sources, so that it builds anywhere with only a C compiler. If a compiler is available at
export, it also holds the library for this platform. `fmi3/` has the interface templates and standard headers.
"""

import hashlib
import os
import platform
import re
import shlex
import shutil
import subprocess
import sys
import tempfile
import warnings
import zipfile
from functools import partial
from pathlib import Path
from typing import Any

import torchpi
from torchpi.errors import ArtifactError, ExportWarning
from torchpi.export.c_source import c_source
from torchpi.export.deployable import Deployable
from torchpi.export.formats import Files
from torchpi.export.templates import rendered
from torchpi.operators.reference_filter import ReferenceFilter

FMI3 = Path(__file__).parent / "fmi3"
HEADERS = ("fmi3Functions.h", "fmi3FunctionTypes.h", "fmi3PlatformTypes.h")
TEMPLATES = {  # and their paths in the archive
    "modelDescription.xml": "modelDescription.xml",
    "buildDescription.xml": "sources/buildDescription.xml",
    "fmi3.c": "sources/{}_fmi3.c",
}
OPTIONS = ("-ffp-contract=off", "-O2")
COMPILE_S = 120.0
INSTALL_COMPILER = {"darwin": "xcode-select --install", "win32": "winget install LLVM.LLVM"}  # else Debian's
SUFFIXES = {"linux": ".so", "darwin": ".dylib", "windows": ".dll"}
MACHINES = {"amd64": "x86_64", "arm64": "aarch64", "i386": "x86", "i686": "x86"}


def fmu_files(
    compensator: Deployable, output: Path, reference_filter: ReferenceFilter | None = None
) -> Files:
    """Return NAME.fmu, where NAME is the last part of `output`.

    Warns (`ExportWarning`) if there is no C compiler or it fails; the FMU then holds only sources.

    Raises:
        ArtifactError: As `c_files`.
    """
    name = output.name
    content = fmu_sources(compensator, name, reference_filter)
    try:
        content |= compiled(content, name)
    except ExportWarning as warning:
        warnings.warn(warning, stacklevel=2)
    return {output.with_name(f"{name}.fmu"): partial(_write, content)}


def fmu_sources(
    compensator: Deployable, name: str, reference_filter: ReferenceFilter | None = None
) -> dict[str, bytes]:
    """Return the contents of the archive by name, without the compiled library.

    Raises:
        ArtifactError: As `c_files`.
    """
    if f"{name}.h" in HEADERS:
        raise ArtifactError(
            f"name for an FMU: found '{name}', a header of FMI; change the last part of --output"
        )
    texts = c_source(compensator, name, reference_filter)
    del texts[f"{name}_selftest.c"]
    stream = compensator.stream(reference_filter)
    context: dict[str, Any] = {
        "name": name,
        "version": torchpi.__version__,
        "input": "Reference y_r" if stream.has_reference_filter else "Desired displacement",
        "preview": stream.preview,
        "period": repr(stream.sample_period_s),
        "low": repr(stream.min_voltage_v),
        "high": repr(stream.max_voltage_v),
        "options": " ".join(OPTIONS),
        "not_offered": _not_offered(),
    }
    # The token identifies the model: a hash of all that determines what it computes and how it is called.
    tokenless = [rendered(f"fmi3/{file}.j2", {**context, "token": ""}) for file in TEMPLATES]
    context["token"] = hashlib.sha256("".join([*texts.values(), *tokenless]).encode()).hexdigest()[:32]
    content = {f"sources/{file}": text for file, text in texts.items()}
    content |= {f"sources/{file}": (FMI3 / file).read_text(encoding="ascii") for file in HEADERS}
    content |= {place.format(name): rendered(f"fmi3/{file}.j2", context) for file, place in TEMPLATES.items()}
    return {file: text.encode() for file, text in content.items()}


def compiled(content: dict[str, bytes], name: str) -> dict[str, bytes]:
    """Return the compiled library for this platform, by its path in the archive.

    Raises:
        ExportWarning: There is no compiler, or it fails to compile the sources.
    """
    without = "the FMU contains no library, only sources"
    compiler = shlex.split(os.environ.get("CC", "cc"))
    if not compiler or shutil.which(compiler[0]) is None:
        raise ExportWarning(
            f"{name}.fmu: found no C compiler '{' '.join(compiler)}', so {without}; run: "
            f"{INSTALL_COMPILER.get(sys.platform, 'apt install gcc')}, or name another compiler in CC"
        )
    system = {"win32": "windows"}.get(sys.platform, sys.platform)
    machine = platform.machine().lower()
    library = f"{name}{SUFFIXES.get(system, '.so')}"
    with tempfile.TemporaryDirectory(prefix="torchpi-") as folder:
        for file, text in content.items():
            Path(folder, Path(file).name).write_bytes(text)
        command = [*compiler, "-std=c99", *OPTIONS, "-shared", "-fPIC", "-fvisibility=hidden"]
        try:
            done = subprocess.run(
                [*command, f"{name}.c", f"{name}_fmi3.c", "-o", library],
                cwd=folder,
                capture_output=True,
                text=True,
                errors="replace",
                timeout=COMPILE_S,
            )
            failed = next(iter(done.stderr.splitlines()), f"exit code {done.returncode}")
        except (OSError, subprocess.TimeoutExpired) as error:
            raise ExportWarning(f"{name}.fmu: {compiler[0]} failed ({error}), so {without}") from error
        if done.returncode or not Path(folder, library).is_file():
            raise ExportWarning(f"{name}.fmu: {compiler[0]} failed ({failed}), so {without}")
        built = Path(folder, library).read_bytes()
    return {f"binaries/{MACHINES.get(machine, machine)}-{system}/{library}": built}


def _not_offered() -> list[tuple[str, str]]:
    """List the FMI functions that the template does not define, with their parameters."""
    declared = (FMI3 / "fmi3FunctionTypes.h").read_text(encoding="ascii")
    found = re.findall(r"typedef\s+fmi3Status\s+(\w+)TYPE\s*\(([^;]*)\);", declared)
    own = (FMI3 / "fmi3.c.j2").read_text(encoding="utf-8")
    return [
        (function, re.sub(r"\s+", " ", parameters))
        for function, parameters in found
        if f"fmi3Status {function}(" not in own
    ]


def _write(content: dict[str, bytes], path: Path) -> None:
    """Write the archive so that equal content gives equal bytes: sorted entries, no time stamps."""
    with zipfile.ZipFile(path, "w") as archive:
        for name in sorted(content):
            entry = zipfile.ZipInfo(name)
            entry.external_attr = (0o755 if name.startswith("binaries/") else 0o644) << 16
            archive.writestr(entry, content[name], zipfile.ZIP_DEFLATED)
