"""The wheel: one top-level name, recipes and training inside, and it works in an empty folder."""

import os
import re
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

import torchpi
import torchpi.files

ROOT = Path(__file__).parents[1]


def in_empty_folder(installed: Path, folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    """Run `python -m torchpi` of the installed wheel; plays in Python: nothing here is worth compiling."""
    environment = {**os.environ, "PYTHONPATH": str(installed), "NUMBA_DISABLE_JIT": "1"}
    command = [sys.executable, "-m", "torchpi", *arguments]
    return subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True)


def test_the_wheel_has_one_top_level_package_with_configs_and_training(wheel: Path) -> None:
    with zipfile.ZipFile(wheel) as archive:
        names = set(archive.namelist())
        about = next(name for name in names if name.endswith("METADATA"))
        metadata = archive.read(about).decode()
    assert {name.split("/")[0] for name in names} == {"torchpi", about.split("/")[0]}
    assert {"torchpi/py.typed", f"{about.split('/')[0]}/licenses/LICENSE"} <= names
    for folder in ("configs", "train", "torchpi"):
        own = [
            path.relative_to(ROOT).as_posix()
            for path in (ROOT / folder).rglob("*")
            if path.is_file() and path.parent.name != "__pycache__"
        ]
        assert {name if folder == "torchpi" else f"torchpi/{name}" for name in own} <= names
    assert not re.search(r"^Requires-Dist: (pytest|ruff|h5py)(?!.*extra ==)", metadata, re.MULTILINE)


def test_an_installed_torchpi_works_in_an_empty_folder(installed: Path, tmp_path: Path) -> None:
    def printed_by(*arguments: str) -> str:
        done = in_empty_folder(installed, tmp_path, *arguments)
        assert done.returncode == 0, done.stderr
        return done.stdout

    # `test_readme.py` runs the other commands from the wheel.
    assert printed_by("--version") == f"torchpi {torchpi.__version__}\n"
    made = printed_by("simulate", "--stage", "default", "--excitation", "sine_5hz", "--duration_s", "0.2")
    assert "on default" in made
    assert {path.name for path in tmp_path.iterdir()} == {"recordings"}


def test_an_unknown_name_is_refused_with_a_list_of_valid_names(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(torchpi.TorchpiError, match=r"record: no such file or name, expected .* recorded"):
        torchpi.files.config_file("record")
    assert torchpi.files.config_file("recorded") == ROOT / "configs" / "recorded.yaml"
    assert torchpi.files.config_file("default", "stage") == ROOT / "configs" / "stage" / "default.yaml"
    for path in ("missing.yaml", "folder/default", "data: {fs_hz: 1}"):
        assert torchpi.files.config_file(path) == Path(path)
    Path("own").write_text("")
    assert torchpi.files.config_file("own") == Path("own")


def test_citation_and_changelog_state_this_version() -> None:
    for file in ("CITATION.cff", "CHANGELOG.md"):
        assert torchpi.__version__ in (ROOT / file).read_text(encoding="utf-8")
