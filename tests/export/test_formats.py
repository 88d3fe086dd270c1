"""An export writes all of its files or none."""

import itertools
import json
import sys
from pathlib import Path

import pytest
import torch

from tests.control.test_corrected import corrected
from tests.control.test_direct_inverse import compensator
from torchpi.cli import commands
from torchpi.control.trained import HASH, HYPER_PARAMETERS, to_checkpoint
from torchpi.errors import ArtifactError, ConfigError
from torchpi.export import export_files, load_torchscript
from torchpi.export.formats import without_suffix, write_together


def contents(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def test_every_format_writes_its_files(tmp_path: Path) -> None:
    files = export_files(compensator(), tmp_path / "demo", ("torchscript", "c", "json"))
    assert [file.name for file in files] == ["demo.pt", "demo.h", "demo.c", "demo_selftest.c", "demo.json"]
    assert set(contents(tmp_path)) == {file.name for file in files}
    assert load_torchscript(tmp_path / "demo.pt").preview == 3
    assert json.loads((tmp_path / "demo.json").read_text())["schema"] == "torchpi.control.direct_inverse/1"


def test_a_dot_in_a_name_is_not_taken_for_a_suffix(tmp_path: Path) -> None:
    (file,) = export_files(compensator(), tmp_path / "v1.2", ("json",))
    assert file.name == "v1.2.json" and file.is_file()


def test_a_single_format_may_be_given_as_a_string(tmp_path: Path) -> None:
    assert export_files(compensator(), tmp_path / "demo", "json") == [tmp_path / "demo.json"]


def test_an_export_can_be_named_by_any_of_its_files() -> None:
    for suffix in (".pt", ".c", ".h", ".json", ".html"):
        assert without_suffix(f"exports/v1.2{suffix}") == Path("exports/v1.2")
    assert without_suffix("exports/v1.2") == Path("exports/v1.2")


@pytest.mark.parametrize("formats", ["jsn", ("onnx",), ("c", "jsn"), (), ("",)])
def test_an_unknown_format_is_refused_with_the_valid_ones(formats: tuple[str, ...], tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="expected one or more of torchscript,c,fmu,pt2,json") as error:
        export_files(compensator(), tmp_path / "out" / "demo", formats)
    assert "\n" not in str(error.value) and list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("name", "formats", "says"),
    [("my-stage", ("torchscript", "c"), "my-stage"), ("demo", ("c", "json"), "CorrectedInverse")],
)
def test_one_refused_format_leaves_all_files_unchanged(
    name: str, formats: tuple[str, ...], says: str, tmp_path: Path
) -> None:
    for suffix in (".pt", ".json", ".c"):
        (tmp_path / f"{name}{suffix}").write_text("before")
    before = contents(tmp_path)
    with pytest.raises(ArtifactError, match=says):
        export_files(corrected(1), tmp_path / name, formats)
    assert contents(tmp_path) == before


def test_a_number_that_is_not_finite_is_refused_by_every_format(tmp_path: Path) -> None:
    made = compensator()
    with torch.no_grad():
        made.offset.fill_(torch.inf)
    for format_ in ("torchscript", "c", "json"):
        with pytest.raises(ArtifactError, match="inf"):
            export_files(made, tmp_path / "demo", (format_,))
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("fails", range(3))
def test_no_file_is_placed_before_all_are_written(fails: int, tmp_path: Path) -> None:
    (tmp_path / "0").write_text("before")
    count = itertools.count()

    def write(path: Path) -> None:
        path.write_text("after")
        if next(count) == fails:
            raise OSError("no space")

    with pytest.raises(ArtifactError, match="no space"):
        write_together({tmp_path / str(k): write for k in range(3)})
    assert contents(tmp_path) == {"0": b"before"}


@pytest.fixture
def checkpoint(tmp_path: Path) -> Path:
    path = tmp_path / "best.ckpt"
    torch.save(to_checkpoint(compensator()), path)
    return path


def export(monkeypatch: pytest.MonkeyPatch, *arguments: str) -> int:
    monkeypatch.setattr(sys, "argv", ["torchpi", "export", *arguments])
    with pytest.raises(SystemExit) as ended:
        commands.main()
    return int(ended.value.code or 0)


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
@pytest.mark.filterwarnings("ignore::FutureWarning")
def test_command_exports_all_formats_and_prints_the_paths_of_the_files(
    checkpoint: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    output = tmp_path / "exports" / "demo"
    arguments = ["--to", "torchscript,c,fmu,pt2,json", "--output", str(output)]
    assert export(monkeypatch, str(checkpoint), *arguments) == 0
    printed = capsys.readouterr().out
    assert len(contents(output.parent)) == 7
    assert all(str(path) in printed for path in output.parent.iterdir())


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["--to", "c,matlab"], "found 'matlab', expected one or more of torchscript,c,fmu,pt2,json"),
        (["--to", "json,c", "--output", "exports/my-stage"], "name for C: found 'my-stage'"),
        (["--to", "c", "--output", "exports/while"], "name for C: found 'while'"),
    ],
)
def test_command_refuses_in_one_line_and_writes_nothing(
    arguments: list[str],
    says: str,
    checkpoint: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(checkpoint.parent)
    assert export(monkeypatch, str(checkpoint), *arguments) == 2
    error = capsys.readouterr().err
    assert error.startswith("torchpi: error: ") and error.count("\n") == 1 and says in error
    assert list(contents(checkpoint.parent)) == [checkpoint.name]


def test_command_refuses_a_sample_period_of_zero(
    checkpoint: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    saved = to_checkpoint(compensator())
    saved[HYPER_PARAMETERS]["sample_period_s"] = 0.0
    del saved[HASH]
    torch.save(saved, checkpoint)
    assert export(monkeypatch, str(checkpoint), "--to", "c", "--output", str(checkpoint.parent / "x")) == 2
    assert "sample_period_s: found 0.0, expected a positive number of s" in capsys.readouterr().err
    assert list(contents(checkpoint.parent)) == [checkpoint.name]
