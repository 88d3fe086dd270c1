"""The TorchScript file: its contract, its numbers, and which files are refused."""

import math
import subprocess
import sys
from pathlib import Path

import pytest
import torch

from torchpi.control.direct_inverse import DirectInverse
from torchpi.errors import ArtifactError
from torchpi.export import export_files, load_torchscript
from torchpi.operators import ReferenceFilter
from torchpi.operators.motion import backward_motion


def compensator() -> DirectInverse:
    made = DirectInverse(1e-4, [0.0, 0.1, 0.4, 1.0], preview=2, lead=1, creep_time_constants_s=[0.5])
    with torch.no_grad():
        made.weights.theta.copy_(torch.tensor([[1.1, 0.01], [-0.2, 0.002], [-0.1, 0.0], [0.05, 0.0]]))
        made.scaled_lead.fill_(1.3)
        made.creep_gains.fill_(-0.02)
    return made


def trajectory() -> torch.Tensor:
    t = 1e-4 * torch.arange(3000, dtype=torch.float64)
    return 3 - 3 * torch.cos(2 * math.pi * 30 * t) + torch.sin(2 * math.pi * 77 * t)


def test_file_has_the_contract_and_the_bits_of_the_batch_pass(tmp_path: Path) -> None:
    export_files(compensator(), tmp_path / "c", ["torchscript"])
    loaded = load_torchscript(tmp_path / "c.pt")
    assert (loaded.sample_period_s, loaded.preview, loaded.held_inputs) == (1e-4, 2, 0)
    yd = trajectory()
    expected = compensator()(backward_motion(yd[None], 1e-4))[0]
    assert torch.equal(loaded.block(yd), expected)
    loaded.reset()
    assert torch.equal(torch.tensor([loaded.step(s) for s in yd.tolist()], dtype=torch.float64), expected)


def test_file_loads_without_torchpi(tmp_path: Path) -> None:
    export_files(compensator(), tmp_path / "c", ["torchscript"])
    program = (
        "import sys, warnings; warnings.simplefilter('ignore'); sys.modules['torchpi'] = None; import torch; "
        "c = torch.jit.load(sys.argv[1]); c.reset(); print(repr(c.step(1.0)), c.sample_period_s, c.preview)"
    )
    printed = subprocess.run(
        [sys.executable, "-c", program, str(tmp_path / "c.pt")], capture_output=True, text=True, check=True
    ).stdout.split()
    assert float(printed[0]) == compensator().stream().step(1.0)
    assert printed[1:] == ["0.0001", "2"]


def test_loading_twice_gives_two_independent_states(tmp_path: Path) -> None:
    export_files(compensator(), tmp_path / "c", ["torchscript"])
    one, other = load_torchscript(tmp_path / "c.pt"), load_torchscript(tmp_path / "c.pt")
    one.step(5.0)
    assert other.step(1.0) == compensator().stream().step(1.0)


def test_changing_the_source_does_not_change_the_exported_file(tmp_path: Path) -> None:
    made = compensator()
    export_files(made, tmp_path / "c", ["torchscript"])
    before = load_torchscript(tmp_path / "c.pt").step(1.0)
    with torch.no_grad():
        made.weights.theta.zero_()
    assert load_torchscript(tmp_path / "c.pt").step(1.0) == before


def test_a_reference_filter_is_exported_on_request(tmp_path: Path) -> None:
    filter_ = ReferenceFilter(1e-4)
    export_files(compensator(), tmp_path / "c", ["torchscript"], filter_)
    loaded = load_torchscript(tmp_path / "c.pt")
    assert loaded.has_reference_filter
    yr = 4 + trajectory()
    assert torch.equal(loaded.block(yr), compensator()(filter_(yr[None]))[0])


def test_failed_save_leaves_the_previous_file_intact(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "c.pt"
    export_files(compensator(), path.with_suffix(""), ["torchscript"])
    before = path.read_bytes()

    def killed(self: Path, content: bytes) -> None:
        self.write_text("half of it")
        raise KeyboardInterrupt

    monkeypatch.setattr(Path, "write_bytes", killed)
    with pytest.raises(KeyboardInterrupt):
        export_files(compensator(), path.with_suffix(""), ["torchscript"])
    monkeypatch.undo()
    assert path.read_bytes() == before and list(tmp_path.iterdir()) == [path]


def test_a_file_that_is_not_a_compensator_is_refused_in_one_line(tmp_path: Path) -> None:
    (tmp_path / "text.pt").write_text("not a model")
    torch.save({"a": 1}, tmp_path / "weights.pt")
    torch.jit.script(torch.nn.Linear(1, 1)).save(str(tmp_path / "other.pt"))
    for name, found in (
        ("missing.pt", "no such file"),
        ("text.pt", "not a TorchScript file"),
        ("weights.pt", "not a TorchScript file"),
        ("other.pt", "expected only a compensator"),
    ):
        with pytest.raises(ArtifactError, match=found) as error:
            load_torchscript(tmp_path / name)
        assert "\n" not in str(error.value)
