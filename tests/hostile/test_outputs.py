"""Outputs that cannot or must not be written: one line, exit code 2, and existing files are kept."""

import errno
import os
import resource
import shutil
import subprocess
import sys
import threading
from pathlib import Path

import numpy as np
import pytest
import torch

from tests.hostile.sequences import compensator
from torchpi.cli.command_line import run_command
from torchpi.control.trained import to_checkpoint
from torchpi.errors import ArtifactError
from torchpi.excitation.files import write_excitation
from torchpi.export import export_files
from torchpi.files import check_output_folder, save_tensors, write_atomically
from train.run_folder import RunFolder, claim, new_run

ROOT = Path(__file__).parents[2]
T = np.arange(2000) / 1e4
U = 5 - 5 * np.cos(2 * np.pi * 25 * T)


def torchpi_command(*arguments: str, **options: object) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "torchpi", *arguments]
    return subprocess.run(command, cwd=ROOT, stderr=subprocess.PIPE, text=True, **options)


def one_line(done: subprocess.CompletedProcess[str]) -> str:
    assert done.returncode == 2, done.stderr
    assert done.stderr.startswith("torchpi: error: ") and done.stderr.count("\n") == 1, done.stderr
    return done.stderr


@pytest.mark.parametrize("target", ["/dev/null", "pipe", ".", "loop", "a/file/below"])
def test_a_target_that_is_not_a_regular_file_is_refused_and_unchanged(target: str, tmp_path: Path) -> None:
    (tmp_path / "a").write_text("mine")
    (tmp_path / "loop").symlink_to("loop")
    os.mkfifo(tmp_path / "pipe")
    before = os.stat("/dev/null")
    with pytest.raises(ArtifactError) as error, write_atomically(tmp_path / target) as temporary:
        temporary.write_text("new")
    assert str(tmp_path / target) in str(error.value) and "\n" not in str(error.value)
    assert os.stat("/dev/null").st_ino == before.st_ino and (tmp_path / "a").read_text() == "mine"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a", "loop", "pipe"]


def test_a_symbolic_link_is_followed(tmp_path: Path) -> None:
    (tmp_path / "folder").mkdir()
    (tmp_path / "link").symlink_to("folder/target.csv")
    for text in ("new", "newer"):
        with write_atomically(tmp_path / "link") as temporary:
            temporary.write_text(text)
        assert (tmp_path / "link").is_symlink()
        assert (tmp_path / "folder" / "target.csv").read_text() == text


def test_temporary_files_of_killed_processes_are_removed_unless_in_use(tmp_path: Path) -> None:
    stale, other = tmp_path / ".a-12345678.csv", tmp_path / ".ab-12345678.csv"
    stale.write_text("half")
    other.write_text("of another file")
    with write_atomically(tmp_path / "a.csv") as first:
        first.write_text("first")
        with write_atomically(tmp_path / "a.csv") as second:
            second.write_text("second")
        assert first.is_file()
    assert (tmp_path / "a.csv").read_text() == "first"
    assert sorted(path.name for path in tmp_path.iterdir()) == [".ab-12345678.csv", "a.csv"]


def test_a_file_name_of_the_maximum_length_is_written(tmp_path: Path) -> None:
    path = tmp_path / ("µ" * 125 + ".csv")
    write_excitation(path, T, U)
    assert path.is_file()


def test_an_unusable_output_folder_is_refused_and_the_check_creates_none(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("mine")
    (tmp_path / "gone").symlink_to("nowhere")
    for path in (tmp_path / "file", tmp_path / "file" / "below", Path("/dev/null/below"), tmp_path / "gone"):
        with pytest.raises(ArtifactError):
            check_output_folder(path)
    check_output_folder(tmp_path / "new" / "folder")
    check_output_folder(Path("new"))
    assert not (tmp_path / "new").exists()


@pytest.mark.parametrize(
    "arguments",
    [
        ("excite",),
        ("simulate", "--excitation", "hold"),
        ("predict", "configs/stage/default.yaml", "{input}"),
        ("check", "{input}"),
        ("export", "{checkpoint}", "--to", "json,c,page"),
    ],
    ids=lambda arguments: arguments[0],
)
def test_a_full_disk_is_reported_in_one_line_and_keeps_the_previous_file(
    arguments: tuple[str, ...], tmp_path: Path
) -> None:
    recording, output, checkpoint = tmp_path / "voltage.csv", tmp_path / "out", tmp_path / "best.ckpt"
    torch.save(to_checkpoint(compensator()), checkpoint)
    recording.write_text(
        "time_s,input_v,output_um\n" + "".join(f"{t},{u},{0.8 * u}\n" for t, u in zip(T, U, strict=True))
    )
    if arguments[0] in ("simulate", "predict"):
        output.write_text("previous")

    def limited() -> None:
        # Limit every file to 4 kB, to imitate a disk that fills up.
        resource.setrlimit(resource.RLIMIT_FSIZE, (4096, 4096))

    done = torchpi_command(
        *(argument.format(input=recording, checkpoint=checkpoint) for argument in arguments),
        "--output",
        str(output),
        stdout=subprocess.PIPE,
        preexec_fn=limited,
    )
    assert "cannot be written (file too large)" in one_line(done)
    left = [output] if output.is_file() else list(output.iterdir()) if output.is_dir() else []
    assert left in ([], [output]) and (not left or output.read_text() == "previous")
    assert not [path for path in tmp_path.rglob(".*")]


@pytest.mark.parametrize("written", range(3))
def test_a_disk_that_fills_up_during_an_export_keeps_all_previous_files(
    written: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    formats = ("json", "torchscript", "page")
    before = {path: path.read_bytes() for path in export_files(compensator(), tmp_path / "a", formats)}
    calls = iter(range(10))

    def fsync(handle: int) -> None:
        if next(calls) == written:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr("torchpi.files.os.fsync", fsync)
    with pytest.raises(ArtifactError, match=r"cannot be written \(no space left on device\)"):
        export_files(compensator(max_slew_v_s=10.0), tmp_path / "a", formats)
    assert {path: path.read_bytes() for path in sorted(tmp_path.iterdir())} == dict(sorted(before.items()))


def test_a_thread_that_cannot_write_prints_no_traceback(capfd: pytest.CaptureFixture[str]) -> None:
    def write() -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    def command() -> None:
        thread = threading.Thread(target=write)
        thread.start()
        thread.join()
        write()

    assert run_command(command, "torchpi") == 2
    error = capfd.readouterr().err
    assert error.startswith("torchpi: error: ") and error.count("\n") == 1


def test_full_or_closed_standard_output_gives_no_traceback(tmp_path: Path) -> None:
    with open("/dev/full", "w") as full:
        assert "no space left" in one_line(
            torchpi_command("excite", "--output", str(tmp_path / "a"), stdout=full)
        )
    command = f'"{sys.executable}" -m torchpi excite --output "{tmp_path / "b"}" >&-'
    done = subprocess.run(command, shell=True, cwd=ROOT, stderr=subprocess.PIPE, text=True)
    assert (done.returncode, done.stderr) == (0, "")


def memory() -> None:
    np.zeros((2**40, 2**10))


def torch_memory() -> None:
    torch.empty(2**60 // 8)


def nested() -> None:
    nested()


@pytest.mark.parametrize("command", [memory, torch_memory, nested])
def test_too_little_memory_is_reported_in_one_line(
    command: object, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run_command(command, "torchpi") == 2
    error = capsys.readouterr().err
    assert error.startswith("torchpi: error: ") and error.count("\n") == 1


@pytest.mark.long
def test_predict_works_without_a_writable_home_or_package(tmp_path: Path) -> None:
    shutil.copytree(ROOT / "torchpi", tmp_path / "torchpi", ignore=shutil.ignore_patterns("__pycache__"))
    for folder in [path for path in (tmp_path / "torchpi").rglob("*") if path.is_dir()] + [
        tmp_path / "torchpi"
    ]:
        (folder / "__pycache__").write_text("a file in the way of caches")
    (tmp_path / "home").write_text("a file")
    write_excitation(tmp_path / "u.csv", T, U)
    environment = {
        **os.environ,
        "HOME": str(tmp_path / "home"),
        "PYTHONPATH": str(tmp_path),
        "PYTHONDONTWRITEBYTECODE": "1",
        "TMPDIR": str(tmp_path / "tmp"),
    }
    for name in ("XDG_CACHE_HOME", "XDG_CONFIG_HOME", "NUMBA_CACHE_DIR", "MPLCONFIGDIR"):
        environment.pop(name, None)
    (tmp_path / "tmp").mkdir()
    program = (
        "import torchpi, matplotlib; from torchpi.cli.commands import main\n"
        f"assert torchpi.__file__.startswith({str(tmp_path)!r})\n"
        "import torchpi.report.png; main()"
    )
    done = subprocess.run(
        [
            sys.executable,
            "-c",
            program,
            "predict",
            str(ROOT / "configs/stage/default.yaml"),
            str(tmp_path / "u.csv"),
            "--output",
            str(tmp_path / "y.csv"),
        ],
        cwd=tmp_path,
        env=environment,
        capture_output=True,
        text=True,
    )
    assert (done.returncode, done.stderr) == (0, "")
    assert (tmp_path / "y.csv").is_file() and not list((tmp_path / "tmp").iterdir())


def test_a_run_folder_is_claimed_by_one_run_at_a_time(tmp_path: Path) -> None:
    folder = RunFolder(tmp_path / "run")
    with (
        claim(folder, goes_on=False),
        pytest.raises(ArtifactError, match="another process is training in it"),
        claim(folder, goes_on=True),
    ):
        raise AssertionError
    with claim(folder, goes_on=False):
        pass


def test_a_run_killed_before_its_first_checkpoint_restarts_in_its_folder(tmp_path: Path) -> None:
    folder = new_run(str(tmp_path / "run"), "run", None)
    with claim(folder, goes_on=False):
        folder.config.write_text("half of it")
        (folder.path / ".run-12345678.json").write_text("")
        (folder.path / "events.out.tfevents.1").write_text("events")
    folder = new_run(str(tmp_path / "run"), "run", None)
    with claim(folder, goes_on=False):
        assert folder.events == []
    folder.checkpoints.mkdir()
    folder.last.write_text("a checkpoint")
    with pytest.raises(ArtifactError, match="--ckpt_path last"):
        new_run(str(tmp_path / "run"), "run", None)
    with pytest.raises(ArtifactError, match="--ckpt_path last"), claim(folder, goes_on=False):
        raise AssertionError


def test_a_folder_with_foreign_files_is_never_cleared(tmp_path: Path) -> None:
    with claim(RunFolder(tmp_path), goes_on=False):
        pass
    (tmp_path / "checkpoints").mkdir()
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(ArtifactError, match=r"notes\.txt|checkpoints"):
        new_run(str(tmp_path), "run", None)


def test_equal_content_gives_identical_bytes_without_temporary_names(tmp_path: Path) -> None:
    for name in ("a.ckpt", "b.ckpt"):
        with write_atomically(tmp_path / name) as temporary:
            save_tensors({"x": torch.arange(3.0)}, temporary)
    assert (tmp_path / "a.ckpt").read_bytes() == (tmp_path / "b.ckpt").read_bytes()
