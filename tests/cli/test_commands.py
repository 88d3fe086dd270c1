"""The `torchpi` command: its help is instructive and fast; bad input gives one line and exit code 2."""

import json
import re
import signal
import subprocess
import sys
import time
import warnings
import weakref
from dataclasses import fields
from pathlib import Path

import pytest
import torch

from tests.control.test_direct_inverse import compensator
from torchpi.cli import commands
from torchpi.cli.command_line import run_command
from torchpi.control.trained import to_checkpoint
from torchpi.errors import RecordingWarning
from torchpi.export import load_torchscript
from torchpi.recordings.recording import RecordingOptions, read_recording

ROOT = Path(__file__).parents[2]
STAGE = str(ROOT / "configs" / "stage" / "default.yaml")


def torchpi(monkeypatch: pytest.MonkeyPatch, *arguments: str) -> int:
    monkeypatch.setattr(sys, "argv", ["torchpi", *arguments])
    with pytest.raises(SystemExit) as ended:
        commands.main()
    return int(ended.value.code or 0)


@pytest.fixture
def run_folder(tmp_path: Path) -> Path:
    """A run folder as training writes it, limited to what the export reads."""
    made = compensator(rate="linear", lead=0, preview=0, creep_time_constants_s=[])
    (tmp_path / "run" / "checkpoints").mkdir(parents=True)
    torch.save(to_checkpoint(made), tmp_path / "run" / "checkpoints" / "best.ckpt")
    return tmp_path / "run"


@pytest.mark.parametrize("command", ["check", "diagnose", "predict"])
def test_help_of_a_command_is_shown_without_importing_torch(command: str) -> None:
    program = "import sys; from torchpi.cli.commands import main\ntry: main()\nexcept SystemExit: pass\n"
    program += "print([m for m in ('torch', 'matplotlib', 'numba') if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", program, command, "--help"], capture_output=True, text=True)
    assert "--input_column" in done.stdout and done.stdout.strip().endswith("[]")


def test_help_lists_the_main_commands_without_importing_torch() -> None:
    program = "import sys; from torchpi.cli.commands import main\ntry: main()\nexcept SystemExit: pass\n"
    program += "heavy = ('torch', 'lightning', 'matplotlib', 'numba', 'scipy', 'numpy')\n"
    program += "print([m for m in heavy if m in sys.modules])"
    done = subprocess.run(
        [sys.executable, "-c", program, "--help"], capture_output=True, text=True, check=True
    )
    assert all(command in done.stdout for command in ("simulate", "torchpi train fit", "export", "run"))
    assert done.stdout.strip().endswith("[]")


def test_import_loads_neither_lightning_nor_matplotlib() -> None:
    program = "import sys, torchpi.control.direct_inverse, torchpi.stage, torchpi.loop, torchpi.export\n"
    program += "assert not {'lightning', 'matplotlib', 'pytorch_lightning'} & set(sys.modules)"
    subprocess.run([sys.executable, "-c", program], check=True)


@pytest.mark.parametrize(
    "command",
    ["simulate", "excite", "export", "run", "commission", "check", "diagnose", "predict", "reproduce"],
)
def test_every_command_has_an_example_and_every_option_an_explanation(
    command: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert torchpi(monkeypatch, command, "--help") == 0
    text = capsys.readouterr().out
    assert f"Example: torchpi {command}" in text
    options = text.partition("positional arguments:")[2] or text.partition("options:")[2]
    assert not re.findall(r"^  (?:--)?\w+(?: [A-Z_]+)?\s+\((?:required|type|default)", options, re.MULTILINE)


def test_simulate_writes_a_recording_that_reads_back(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "r.csv"
    assert (
        torchpi(monkeypatch, "simulate", "--stage", STAGE, "--output", str(path), "--duration_s", "0.3") == 0
    )
    recording = read_recording(path)
    assert recording.fs_hz == 10_000 and len(recording) == 3000
    assert "3,000 samples" in capsys.readouterr().out
    first = path.read_bytes()
    torchpi(monkeypatch, "simulate", "--stage", STAGE, "--output", str(path), "--duration_s", "0.3")
    assert path.read_bytes() == first


def test_export_and_run_write_files_a_page_and_numbers(
    run_folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    output = tmp_path / "exports" / "c"
    assert torchpi(monkeypatch, "export", str(run_folder), "--output", str(output)) == 0
    assert load_torchscript(output.with_suffix(".pt")).sample_period_s == 1e-4
    assert json.loads(output.with_suffix(".json").read_text())["schema"] == "torchpi.control.direct_inverse/1"
    trajectory = tmp_path / "t.csv"
    rows = [f"{k * 1e-4:.4f},{1.5e-5 * k * k / 100:.8f}" for k in range(500)]
    trajectory.write_text("time_s,yd_um\n" + "\n".join(rows) + "\n")
    code = torchpi(monkeypatch, "run", f"{output}.pt", "--stage", STAGE, "--trajectory", str(trajectory))
    assert code == 0
    assert (output / "loop.html").is_file() and (output / "loop.json").is_file()
    assert "without compensation" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["simulate", "--excitaton", "hold"], "nearest is 'excitation'"),
        (["simulate", "--excitation", "multisin"], "multisine"),
        (["simulate", "--stage", "nowhere.yaml"], "nowhere.yaml"),
        (["simulate", "--options", "{hihg_hz: 3}", "--excitation", "multisine"], "high_hz"),
        (["simulate", "--duration_s", "soon"], "error: duration_s: found soon, expected float or null\n"),
        (["check", "a.csv", "--zero", "left"], "error: zero: found left, expected 'recorded', 'first'\n"),
        (["export", "nowhere", "--output", "x"], "nowhere"),
        (["export", "README.md", "--output", "x"], "README.md: not a checkpoint"),
        (["run", "nowhere.pt"], "nowhere.pt: no such file"),
        (["run", "README.md"], "README.md: not a TorchScript file"),
        (["exprt"], "choose from"),
        (["reproduce", "--only", "fig99"], "fig8"),
    ],
)
def test_bad_input_gives_one_line_and_exit_code_2(
    arguments: list[str],
    says: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "configs" / "stage").mkdir(parents=True)
    (tmp_path / "configs" / "stage" / "default.yaml").write_text(Path(STAGE).read_text())
    (tmp_path / "README.md").write_text("# not a model")
    before = sorted(tmp_path.rglob("*"))
    assert torchpi(monkeypatch, *arguments) == 2
    error = capsys.readouterr().err
    assert error.startswith("torchpi: error: ") and error.count("\n") == 1 and says in error
    assert sorted(tmp_path.rglob("*")) == before


@pytest.mark.parametrize(
    "arguments", [["check", "nowhere.csv"], ["diagnose", "nowhere.csv"], ["run", "nowhere.pt"]]
)
def test_no_duration_is_announced_for_a_missing_file(
    arguments: list[str], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert torchpi(monkeypatch, *arguments) == 2
    said = capsys.readouterr()
    assert "no such file" in said.err and said.out == ""


@pytest.mark.parametrize("command", ["check", "commission", "diagnose", "predict", "fit"])
def test_every_command_reads_recordings_with_the_same_options(
    command: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    if command == "fit":
        from train.cli import main

        with pytest.raises(SystemExit):
            main(["fit", "--help"])
        prefix = "--data."
    else:
        torchpi(monkeypatch, command, "--help")
        prefix = "--"
    offered = set(re.findall(rf"^  {prefix}(\w+) ", capsys.readouterr().out, re.MULTILINE))
    assert {field.name for field in fields(RecordingOptions)} <= offered


def test_a_recording_warning_is_printed_in_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    def command() -> None:
        warnings.simplefilter("always", RecordingWarning)
        warnings.warn("a.csv: starts at 30 µm", RecordingWarning, stacklevel=2)

    before = warnings.showwarning
    assert run_command(command, "torchpi") == 0
    assert capsys.readouterr().err == "torchpi: warning: a.csv: starts at 30 µm\n"
    assert warnings.showwarning is before


def test_an_interrupt_in_a_callback_that_swallows_exceptions_still_ends_the_command(
    capsys: pytest.CaptureFixture[str],
) -> None:
    class Node:
        pass

    def command() -> None:
        node = Node()
        reference = weakref.ref(node, lambda _: signal.raise_signal(signal.SIGINT))
        del node
        assert reference() is None
        time.sleep(5.0)

    assert run_command(command, "torchpi") == 130
    assert capsys.readouterr().err == "torchpi: interrupted; files already written are complete\n"


@pytest.mark.parametrize("module", ["llvmlite.binding.executionengine", "importlib._bootstrap"])
@pytest.mark.parametrize(("number", "word"), [("SIGINT", "interrupted"), ("SIGTERM", "terminated")])
def test_a_signal_where_no_exception_is_safe_ends_the_command_at_once(
    module: str, number: str, word: str
) -> None:
    program = f"""
import signal
from torchpi.cli.command_line import run_command

scope = {{"__name__": "{module}", "signal": signal}}
exec("def called_back():\\n    signal.raise_signal(signal.{number})", scope)

def command():
    try:
        scope["called_back"]()
    except BaseException:
        print("an exception went through", flush=True)

run_command(command, "torchpi")
"""
    ended = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert (ended.returncode, ended.stdout) == (128 + getattr(signal, number), "")
    assert ended.stderr == f"torchpi: {word}; files already written are complete\n"


def test_a_stage_with_an_unphysical_value_is_refused_by_name_and_value(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    stage = tmp_path / "stage.yaml"
    stage.write_text(Path(STAGE).read_text().replace("damping_ratio: 0.02", "damping_ratio: -0.02"))
    assert torchpi(monkeypatch, "simulate", "--stage", str(stage), "--output", str(tmp_path / "r.csv")) == 2
    assert "damping_ratio: found -0.02" in capsys.readouterr().err
    assert not (tmp_path / "r.csv").exists()


def test_shell_completions_contain_commands_and_options(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("shtab", reason="needs shtab: pip install 'torchpi[completion]'")
    assert torchpi(monkeypatch, "--print_completion", "shtab-bash") == 0
    written = capsys.readouterr().out
    assert all(command in written for command in ("simulate", "diagnose", "--max_rate_v_s"))
    of_fit = re.search(r"^_shtab_torchpi_train_fit_option_strings=\((.*)\)$", written, re.MULTILINE)
    assert of_fit and {"--config", "--data.recordings", "--output"} <= set(of_fit[1].split())


def test_completions_without_shtab_are_refused_with_its_install_command(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "shtab", None)
    assert torchpi(monkeypatch, "--print_completion", "shtab-bash") == 2
    error = capsys.readouterr().err
    assert error == "torchpi: error: --print_completion needs shtab; run: pip install 'torchpi[completion]'\n"
