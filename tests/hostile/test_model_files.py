"""Model files that are damaged, foreign or malicious are refused in one line; none of their code runs."""

import linecache
import random
import struct
import subprocess
import sys
import warnings
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import torch
from torch import Tensor, nn

from tests.export.test_torchscript import compensator
from tests.hostile.sequences import compensator as trained
from torchpi.control.trained import HASH, HYPER_PARAMETERS, STATE, load_compensator, to_checkpoint
from torchpi.errors import ArtifactError
from torchpi.export import export_files, load_torchscript
from torchpi.export.torchscript_check import METHODS

ATTRIBUTES = {
    "sample_period_s": 1e-4,
    "preview": 0,
    "min_voltage_v": 0.0,
    "max_voltage_v": 10.0,
    "has_reference_filter": False,
    "held_inputs": 0,
    "outside_range": 0,
    "limited_outputs": 0,
}
TEMPLATE = """
class Hostile(nn.Module):
    def __init__(self, attributes):
        super().__init__()
        for name, value in attributes.items():
            setattr(self, name, value)
        self.numbers = torch.jit.annotate(List[float], [0.0, 1.0])
    @torch.jit.export
    def reset(self) -> None:
        {reset}
    @torch.jit.export
    def reset_at(self, yd: float) -> float:
        return yd
    @torch.jit.export
    def reset_at_voltage(self, voltage_v: float) -> float:
        return voltage_v
    @torch.jit.export
    def step(self, yd: float) -> float:
        {step}
        return yd
    @torch.jit.export
    def block(self, yd: Tensor) -> Tensor:
        {block}
        return yd
"""
serial = iter(range(10**6))


def hostile_file(
    folder: Path, step: str = "pass", reset: str = "pass", block: str = "pass", **changes: Any
) -> Path:
    """Write a TorchScript file with the contract of a compensator and other code in it."""
    text = TEMPLATE.format(step=step, reset=reset, block=block)
    filename = f"<hostile {next(serial)}>"
    linecache.cache[filename] = (len(text), None, text.splitlines(True), filename)
    namespace: dict[str, Any] = {"torch": torch, "nn": nn, "Tensor": Tensor, "List": list}
    exec("from typing import List, Tuple", namespace)
    exec(compile(text, filename, "exec"), namespace)
    path = folder / "hostile.pt"
    scripted = torch.jit.script(namespace["Hostile"]({**ATTRIBUTES, **changes}).eval())
    # Frozen as by the exporter, with all attributes preserved.
    kept = [*METHODS, *ATTRIBUTES, "numbers"]
    path.write_bytes(torch.jit.freeze(scripted, preserved_attrs=kept).save_to_buffer())
    return path


def refused(path: Path, load: Callable[[Path], object] = load_torchscript) -> str:
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message=".*torch.jit.*deprecated.*")
        with pytest.raises(ArtifactError) as error:
            load(path)
    assert "\n" not in str(error.value) and path.name in str(error.value)
    return str(error.value)


OPERATORS = [
    "yd = float(torch.from_file('{file}', True, int(yd))[0])",
    "yd = float(torch.ones([int(yd)]).sum())",
    "yd = float(torch.rand([2])[0])",
    "yd = float(torch.tensor(yd))",
    "yd = float(torch.empty([1 << 40]).sum())",
    "print(yd)",
    "assert yd > 1e300",
    "raise ValueError('no')",
    "self.numbers = self.numbers * 1000000000",
    "self.numbers = [yd, yd]",
    "self.numbers.append(yd)",
    "self.numbers.clear()",
    "self.numbers = sorted(self.numbers)",
    "self.held_inputs = int(yd)",
    "self.held_inputs = self.held_inputs << 60",
    "yd = yd ** 1e6",
    "yd = float(round(yd))",
    "torch.manual_seed(3)",
    "yd = float(torch.sqrt(torch.full([1], yd))[0])",
]
LOOPS = [
    "while yd == yd: self.held_inputs += 1",
    "while True: self.held_inputs += 1",
    "for i in range(1000000000): self.held_inputs += 1",
    "for i in range(-(1 << 62), 1): self.held_inputs += 1",
    "for i in range(self.held_inputs): self.held_inputs += 1",
]


def test_a_file_with_the_contract_alone_is_read(tmp_path: Path) -> None:
    assert load_torchscript(hostile_file(tmp_path)).step(1.0) == 1.0


@pytest.mark.parametrize("statement", [*OPERATORS, *LOOPS])
def test_a_foreign_operator_or_loop_is_refused_without_running(statement: str, tmp_path: Path) -> None:
    target = tmp_path / "target"
    target.write_bytes(b"mine")
    refused(hostile_file(tmp_path, step=statement.replace("{file}", str(target))))
    assert target.read_bytes() == b"mine"


@pytest.mark.parametrize("place", ["reset", "block"])
def test_reset_and_block_are_checked_as_well(place: str, tmp_path: Path) -> None:
    refused(
        hostile_file(
            tmp_path, **{place: "self.held_inputs = len(torch.from_file('nowhere', True, self.held_inputs))"}
        )
    )


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("sample_period_s", 0.0),
        ("sample_period_s", -1.0),
        ("sample_period_s", float("inf")),
        ("sample_period_s", 1),
        ("preview", -1),
        ("preview", 10**9),
        ("preview", 0.0),
        ("min_voltage_v", 10.0),
        ("max_voltage_v", float("nan")),
        ("has_reference_filter", 1),
        ("held_inputs", 0.0),
        ("min_voltage_v", torch.zeros(())),
        ("preview", "3"),
    ],
)
def test_an_invalid_attribute_is_refused(name: str, value: object, tmp_path: Path) -> None:
    refused(hostile_file(tmp_path, **{name: value}))


@pytest.fixture(scope="module")
def good(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    path = tmp_path_factory.mktemp("good") / "c.pt"
    export_files(compensator(), path.with_suffix(""), ["torchscript"])
    return path.read_bytes()


@pytest.mark.parametrize("seed", range(12))
def test_a_damaged_file_is_refused_or_gives_the_same_numbers(seed: int, good: bytes, tmp_path: Path) -> None:
    rng, path = random.Random(seed), tmp_path / "c.pt"
    content = bytearray(good)
    if seed % 3 == 0:
        del content[rng.randrange(len(content)) :]
    elif seed % 3 == 1:
        content[rng.randrange(len(content))] ^= 1 << rng.randrange(8)
    else:
        at = rng.randrange(len(content) - 64)
        content[at : at + 64] = rng.randbytes(64)
    path.write_bytes(content)
    try:
        loaded = load_torchscript(path)
    except ArtifactError as error:
        assert "\n" not in str(error)
    else:
        assert loaded.step(1.0) == compensator().stream().step(1.0)


def rewritten(path: Path, good: bytes, change: Callable[[str, bytes], tuple[str, bytes] | None]) -> Path:
    path.with_suffix(".from").write_bytes(good)
    with zipfile.ZipFile(path.with_suffix(".from")) as old, zipfile.ZipFile(path, "w") as new:
        for name in old.namelist():
            changed = change(name, old.read(name))
            if changed is not None:
                new.writestr(*changed)
    return path


def test_an_archive_with_an_unexpected_part_number_or_call_is_refused(good: bytes, tmp_path: Path) -> None:
    path = tmp_path / "c.pt"

    def with_tensor(name: str, content: bytes) -> tuple[str, bytes]:
        return (name.replace("byteorder", "constants/0"), content)

    assert "a part" in refused(rewritten(path, good, with_tensor))

    def with_nan(name: str, content: bytes) -> tuple[str, bytes]:
        number = b"G" + struct.pack(">d", 1e-4)
        return (name, content.replace(number, b"G" + struct.pack(">d", float("nan"))))

    assert "the number nan" in refused(rewritten(path, good, with_nan))

    def with_call(name: str, content: bytes) -> tuple[str, bytes]:
        return (name, content.replace(b"__torch__.builtins", b"os.system_builtins"))

    refused(rewritten(path, good, with_call))


def test_code_that_would_run_on_loading_is_refused_without_running(good: bytes, tmp_path: Path) -> None:
    def with_setstate(name: str, content: bytes) -> tuple[str, bytes]:
        return (name, content.replace(b"def reset(", b"def __setstate__("))

    assert "a method '__setstate__'" in refused(rewritten(tmp_path / "c.pt", good, with_setstate))


def test_a_pickle_in_place_of_a_model_is_refused_without_running(tmp_path: Path) -> None:
    target = tmp_path / "target"

    class Runs:
        def __reduce__(self) -> tuple[Any, ...]:
            return Path.touch, (target,)

    for name, load in (("c.ckpt", load_compensator), ("c.pt", load_torchscript)):
        torch.save({HYPER_PARAMETERS: Runs(), STATE: Runs()}, tmp_path / name)
        refused(tmp_path / name, load)
    assert not target.exists()


@pytest.fixture(scope="module")
def checkpoint(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("checkpoint") / "best.ckpt"
    torch.save(to_checkpoint(trained()), path)
    return path


def test_a_checkpoint_keeps_the_trained_ranges_and_step_limits(checkpoint: Path) -> None:
    loaded = load_compensator(checkpoint)
    assert loaded.trained == trained().trained is not None
    assert loaded.step_limits() == trained().step_limits()


@pytest.mark.parametrize("seed", range(10))
def test_one_flipped_bit_in_a_checkpoint_is_refused_or_changes_nothing(
    seed: int, checkpoint: Path, tmp_path: Path
) -> None:
    content = bytearray(checkpoint.read_bytes())
    rng = random.Random(seed)
    content[rng.randrange(len(content))] ^= 1 << rng.randrange(8)
    path = tmp_path / "best.ckpt"
    path.write_bytes(content)
    try:
        loaded = load_compensator(path)
    except ArtifactError as error:
        assert "\n" not in str(error)
    else:
        assert all(
            torch.equal(a, b) for a, b in zip(loaded.parameters(), trained().parameters(), strict=True)
        )


@pytest.mark.parametrize(
    "change",
    [
        lambda saved: saved[STATE]["offset"].add_(1e-12),
        lambda saved: saved[HYPER_PARAMETERS].update(max_voltage_v=1000.0),
        lambda saved: saved.update({HYPER_PARAMETERS: [1, 2]}),
        lambda saved: saved.update({STATE: None}),
        lambda saved: saved.update({HASH: 3}),
        lambda saved: saved.pop(STATE),
    ],
)
def test_a_modified_checkpoint_is_refused(
    change: Callable[[dict[str, Any]], object], checkpoint: Path, tmp_path: Path
) -> None:
    saved = torch.load(checkpoint, weights_only=True)
    change(saved)
    torch.save(saved, tmp_path / "best.ckpt")
    refused(tmp_path / "best.ckpt", load_compensator)


@pytest.mark.parametrize(
    "parameters",
    [
        {"thresholds": "many"},
        {"sample_period_s": "fast"},
        {"sample_period_s": [1.0]},
        {"degree": 10**9},
        {"rate": 3},
        {"trained": {"range_um": [0, 1]}},
        {"trained": 3},
        {"no_such": 1},
        {"max_slew_v_s": "x"},
        {"creep_time_constants_s": [[1.0]]},
        {"preview": None},
    ],
)
def test_invalid_parameters_are_refused_in_one_line(
    parameters: dict[str, Any], checkpoint: Path, tmp_path: Path
) -> None:
    saved = torch.load(checkpoint, weights_only=True)
    saved[HYPER_PARAMETERS].update(parameters)
    del saved[HASH]
    torch.save(saved, tmp_path / "best.ckpt")
    refused(tmp_path / "best.ckpt", load_compensator)


def test_equal_exports_have_identical_bytes(tmp_path: Path) -> None:
    # In separate processes, since torch numbers the classes that a process has compiled.
    program = (
        "import sys; from tests.hostile.sequences import compensator; "
        "from torchpi.export import export_files; export_files(compensator(), sys.argv[1], ['torchscript'])"
    )
    for name in ("a", "b"):
        command = [sys.executable, "-W", "ignore", "-c", program, str(tmp_path / name)]
        subprocess.run(command, check=True, cwd=Path(__file__).parents[2])
    assert (tmp_path / "a.pt").read_bytes() == (tmp_path / "b.pt").read_bytes()


def test_a_file_contains_no_name_of_a_temporary_file(good: bytes, tmp_path: Path) -> None:
    (tmp_path / "c.pt").write_bytes(good)
    with zipfile.ZipFile(tmp_path / "c.pt") as archive:
        assert {name.partition("/")[0] for name in archive.namelist()} == {"archive"}
    assert b".c-" not in good
