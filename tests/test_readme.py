"""Every command and every line of Python in the README runs, in its order, in an empty folder."""

import json
import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")
TUTORIAL = (ROOT / "docs" / "mismatch.md").read_text(encoding="utf-8")  # has commands of the README only


def blocks(language: str, page: str = README) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", page, re.DOTALL)


def test_readme_commands_and_python_run_in_their_order(tmp_path: Path) -> None:
    environment = dict(os.environ)
    environment["PATH"] = f"{Path(sys.executable).parent}{os.pathsep}{environment['PATH']}"
    commands = [line for block in blocks("sh") for line in block.splitlines() if not line.startswith("make ")]
    assert sum("torchpi" in command for command in commands) >= 6
    for command in commands:
        done = subprocess.run(
            shlex.split(command), cwd=tmp_path, env=environment, capture_output=True, text=True
        )
        assert done.returncode == 0, f"{command}\n{done.stdout}\n{done.stderr}"
    diagnosis = json.loads((tmp_path / "diagnosis" / "diagnosis.json").read_text(encoding="utf-8"))
    names = {effect["name"] for effect in diagnosis["effects"]}
    assert diagnosis["verdict"] != "nothing_missing"
    assert {"resonance", "creep"} <= names
    assert names & {"amplifier_lag", "sensor_lag", "delay"}
    assert (tmp_path / "runs" / "mine" / "report.html").is_file()
    assert (tmp_path / "exports" / "mine" / "loop.html").is_file()
    for program in [*blocks("python"), *blocks("python", TUTORIAL)]:
        program = "import warnings; warnings.simplefilter('ignore')\n" + program
        done = subprocess.run([sys.executable, "-c", program], cwd=tmp_path, capture_output=True, text=True)
        assert done.returncode == 0, f"{program}\n{done.stderr}"


def test_readme_make_targets_exist() -> None:
    targets = [line.split()[1] for block in blocks("sh") for line in block.splitlines() if "make " in line]
    assert targets == ["demo", "test"]
    for target in targets:
        assert re.search(rf"^{target}:", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE)


def test_readme_cpp_is_that_of_the_example_which_is_built() -> None:
    example = (ROOT / "exports" / "cpp_loop" / "main.cpp").read_text(encoding="utf-8")
    for line in "".join(blocks("cpp")).splitlines():
        call = re.sub(r"\(.*", "(", line.split("=", 1)[1].strip())
        assert call in example, line


def test_readme_names_files_that_exist() -> None:
    for path in re.findall(r"\]\(([\w./]+)\)", README):
        assert (ROOT / path).exists(), path
    for path in re.findall(r"^\| `([\w./]+/?)`", README, re.MULTILINE):
        assert (ROOT / path).exists(), path
