"""Layers import only from layers below them: computation never imports presentation."""

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
LAYERS = (
    "errors",
    "files",
    "operators",
    "recordings",
    "simulators",
    "excitation",
    "stage",
    "control",
    "diagnosis",
    "identification",
    "loop",
    "paper",
    "report",
    "export",
    "commission",
    "notebook",  # fits by the commission's recipe, and draws its results by report
    "cli",
)


ASKED_FOR = {
    # A recording is drawn by layers above it, imported only when it is drawn.
    "torchpi/recordings/shown.py": {"torchpi.notebook.recorded", "torchpi.report.notebook"},
}


def imported(file: Path) -> set[str]:
    """Return the modules of this repository that a file imports, anywhere in it."""
    names: set[str] = set()
    for node in ast.walk(ast.parse(file.read_text())):
        if isinstance(node, ast.ImportFrom) and node.module:
            names.add(node.module)
        elif isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
    return {name for name in names if name.split(".")[0] in ("torchpi", "train", "tests", "benchmarks")}


def test_every_part_of_the_package_belongs_to_a_layer() -> None:
    parts = {path.stem for path in (ROOT / "torchpi").iterdir() if path.suffix == ".py" or path.is_dir()}
    assert parts - {"__init__", "__main__", "__pycache__"} == set(LAYERS)


@pytest.mark.parametrize("layer", LAYERS)
def test_no_layer_imports_one_above_it(layer: str) -> None:
    home = ROOT / "torchpi" / layer
    above = [f"torchpi.{name}" for name in LAYERS[LAYERS.index(layer) + 1 :]]
    for file in [*home.rglob("*.py"), *home.parent.glob(f"{layer}.py")]:
        wrong = [name for name in imported(file) if name.startswith(("train", "tests", "benchmarks"))]
        names = imported(file) - ASKED_FOR.get(str(file.relative_to(ROOT)), set())
        wrong += [name for name in names if ".".join(name.split(".")[:2]) in above]
        assert not wrong, f"{file.relative_to(ROOT)} imports {sorted(wrong)}"


@pytest.mark.parametrize("part", ["torchpi", "train"])
def test_no_source_file_is_longer_than_450_lines(part: str) -> None:
    lines = {str(file): len(file.read_text().splitlines()) for file in (ROOT / part).rglob("*.py")}
    assert {file: count for file, count in lines.items() if count > 450} == {}
