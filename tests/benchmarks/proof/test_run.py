"""A run: a frozen tree, seeds drawn once, nothing sealed in reach of the tool, resumable."""

import ast
import json
import subprocess
import sys
from concurrent.futures import Executor, Future
from pathlib import Path
from types import SimpleNamespace

import concealed
import numpy as np
import pytest
from concealed import run as running
from concealed import tracks
from concealed.__main__ import main
from concealed.cases import Case
from concealed.entries import ENTRIES, Entry, ask
from concealed.run import RunError, check_frozen, development_seeds, draw_seeds, open_executor, run
from concealed.tracks import DATA, PROOF

PACKAGE = Path(concealed.__path__[0])
SEEDS = {"commit": "abc", "seeds": {"alien": 1, "noise": 2}, "counts": {"alien": 3, "noise": 2}}
TOOL = """
import json, os, pathlib, sys
out, files = pathlib.Path(sys.argv[1]), sys.argv[2:]
given = sorted(p.name for p in pathlib.Path(files[0]).parent.iterdir())
assert given in (["a.csv"], ["a.csv", "heldout_input.csv"]), given
rms = {"heldout_rms_um": 1.0}
fit = {"retuned": rms, "augmented": rms}
effect = {"name": "creep", "probability": 0.9, "alternatives": [], "parameters": {}, "share": 1.0}
answer = {"verdict": "explained", "effects": [effect], "fit": fit}
(out / "diagnosis.json").write_text(json.dumps(answer))
with open(pathlib.Path(__file__).with_suffix(".log"), "a") as log:
    log.write(files[0] + "\\n")
"""


class AtOnce(Executor):
    """Runs what is submitted where it stands."""

    def submit(self, function, /, *arguments):
        future = Future()
        try:
            future.set_result(function(*arguments))
        except BaseException as error:
            future.set_exception(error)
        return future


def tiny(track: str, seed: int, index: int, data: Path) -> Case:
    """A case of ten samples; the odd ones of "noise" are injections."""
    columns = {name: np.arange(10.0) for name in ("time_s", "input_v", "output_um")}
    creep = {"name": "creep", "listed": True, "severity": 5.0, "severity_beyond_plays": 5.0, "parameters": {}}
    common = {"track": track, "noise_rms_um": 1.0, "severity": 5.0, "parameters": {}, "form": "a form"}
    if track == "noise" and index % 2 == 0:
        about = {
            "source": "motor_a",
            "kind": "creep",
            "name": "creep",
            "accepted": ["creep"],
            "untouched": "u",
        }
        return Case([columns], common | about, untouched=[columns])
    null = index % 4 == 0
    about = {"fs_hz": 1.0, "timing": "end_of_hold", "family": "pi", "unknown": [], "tolerated": []}
    names = {"names": [] if null else ["creep"], "effects": [] if null else [creep]}
    return Case([columns], common | about | names, columns)


@pytest.fixture
def entry(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Entry:
    monkeypatch.setattr(running, "draw", tiny)
    script = tmp_path / "tool.py"
    script.write_text(TOOL)
    return Entry("tool", f"{sys.executable} {script} {{out}} {{recordings}}")


def asked(tmp_path: Path) -> int:
    return len((tmp_path / "tool.log").read_text().splitlines())


class TestRun:
    def test_every_case_is_on_record_with_its_verdict(self, tmp_path, entry):
        results = run(SEEDS, entry, tmp_path / "out", AtOnce(), DATA, ("alien", "noise"))
        written = json.loads((tmp_path / "out" / "results.json").read_text())
        assert written == json.loads(json.dumps(results))
        assert [(c["track"], c["case"], c["verdict"]) for c in written["cases"]] == [
            *(("alien", f"case_000{k}", "explained") for k in (1, 2, 3)),
            *(("noise", f"case_000{k}", "explained") for k in (1, 2)),
        ]
        assert written["tracks"]["alien"]["false_alarms"]["count"] == 1
        assert written["tracks"]["alien"]["group"]["count"] == 2
        # The untouched recording has the name as well.
        assert written["tracks"]["noise"]["named_before"] == 1
        assert (written["commit"], written["seeds"]) == ("abc", SEEDS["seeds"])

    def test_what_is_on_record_is_not_asked_again(self, tmp_path, entry):
        run(SEEDS, entry, tmp_path / "out", AtOnce(), DATA, ("alien",), limit=1)
        assert asked(tmp_path) == 1
        first = run(SEEDS, entry, tmp_path / "out", AtOnce(), DATA, ("alien",))
        assert asked(tmp_path) == 3
        assert run(SEEDS, entry, tmp_path / "out", AtOnce(), DATA, ("alien",)) == first
        assert asked(tmp_path) == 3

    def test_records_of_another_commit_or_command_are_refused(self, tmp_path, entry):
        run(SEEDS, entry, tmp_path / "out", AtOnce(), DATA, ("alien",), limit=1)
        with pytest.raises(RunError, match="found commit 'abc', expected 'def'"):
            run(SEEDS | {"commit": "def"}, entry, tmp_path / "out", AtOnce(), DATA, ("alien",), limit=1)
        other = Entry("tool", entry.diagnose + " ")
        with pytest.raises(RunError, match="diagnose"):
            run(SEEDS, other, tmp_path / "out", AtOnce(), DATA, ("alien",), limit=1)

    def test_untouched_recordings_are_asked_once_for_all_their_cases(self, tmp_path, entry, monkeypatch):
        monkeypatch.setattr(running, "untouched_recordings", lambda seed, index: ("motor_a", False))
        seeds = SEEDS | {"counts": {"noise": 5}}
        run(seeds, entry, tmp_path / "out", AtOnce(), DATA, ("noise",))
        assert asked(tmp_path) == 5 + 1

    def test_progress_and_an_estimate_are_printed(self, tmp_path, entry, capsys):
        run(SEEDS, entry, tmp_path / "out", AtOnce(), DATA, ("alien",))
        last = capsys.readouterr().err.splitlines()[-1]
        assert last.startswith("3/3 alien_000") and last.endswith(": 0 s; about 0 min left")

    def test_an_executor_is_processes_or_dask(self):
        with open_executor("processes:1") as pool:
            assert pool.submit(abs, -3).result() == 3
        with pytest.raises(RunError, match="expected processes:N or dask:ADDRESS"):
            open_executor("cloud")

    def test_a_dask_cluster_is_asked_for_its_executor(self, monkeypatch):
        class Client:
            def __init__(self, address: str) -> None:
                self.address = address

            def get_executor(self) -> str:
                return f"executor of {self.address}"

        monkeypatch.setitem(sys.modules, "distributed", SimpleNamespace(Client=Client))
        assert open_executor("dask:tcp://10.0.0.1:8786") == "executor of tcp://10.0.0.1:8786"


class TestEntries:
    def given(self, tmp_path: Path) -> Path:
        (tmp_path / "given").mkdir()
        for name in ("a", "heldout_input"):
            (tmp_path / "given" / f"{name}.csv").write_text("time_s,input_v,output_um\n0,0,0\n1,1,1\n")
        return tmp_path / "given"

    @pytest.mark.parametrize(
        ("command", "why"),
        [
            ("false", "exit 1"),
            ("true", "diagnosis.json"),
            ("no-such-tool-here", "No such file"),
            (f"{sys.executable} -c 'import time; time.sleep(60)'", "no answer in 0.5 s"),
        ],
    )
    def test_what_fails_says_why_and_has_no_diagnosis(self, tmp_path, command, why):
        answer = ask(Entry("x", command, "true", timeout_s=0.5), self.given(tmp_path), tmp_path / "out")
        assert answer.diagnosis is None and why in answer.failure and answer.predicted_um.size == 0

    def test_a_diagnosis_stands_where_only_the_prediction_fails(self, tmp_path):
        script = tmp_path / "tool.py"
        script.write_text(TOOL)
        entry = Entry("x", f"{sys.executable} {script} {{out}} {{recordings}}", "false")
        answer = ask(entry, self.given(tmp_path), tmp_path / "out")
        assert answer.diagnosis["verdict"] == "explained" and answer.predicted_um.size == 0
        assert ask(Entry("x", entry.diagnose), tmp_path / "given", tmp_path / "out").predicted_um is None

    @pytest.mark.parametrize("name", sorted(ENTRIES.keys() - {"torchpi"}))
    def test_rivals_keep_the_contract(self, tmp_path, name):
        folder = tmp_path / "given"
        folder.mkdir()
        t = np.arange(1500) / 500
        u = 5 - 5 * np.cos(2 * np.pi * t * (1 + t))
        y = 2 * u + 0.3 * np.sin(u) + np.random.default_rng(0).normal(0, 0.01, t.size)
        for file in ("a", "b"):
            np.savetxt(
                folder / f"{file}.csv",
                np.column_stack([t, u, y]),
                delimiter=",",
                comments="",
                header="time_s,input_v,output_um",
            )
        np.savetxt(
            folder / "heldout_input.csv",
            np.column_stack([t, u]),
            delimiter=",",
            comments="",
            header="time_s,input_v",
        )
        answer = ask(ENTRIES[name], folder, tmp_path / "out")
        assert not answer.failure
        assert answer.diagnosis["verdict"] in ("explained", "nothing_missing")
        if ENTRIES[name].predict:
            assert np.sqrt(np.mean((answer.predicted_um - y) ** 2)) < 0.5


class TestDrawing:
    def draw_of(self, monkeypatch, finite_from: int) -> list[int]:
        asked = []

        def drawn(track: str, seed: int, index: int, *residual: object) -> Case:
            asked.append(index)
            y = np.full(10, 1.0 if len(asked) >= finite_from else np.nan)
            return Case([{"output_um": np.zeros(10)}], {}, heldout={"output_um": y})

        monkeypatch.setattr(tracks, "draw_alien", drawn)
        tracks.draw("open", 7000, 14)
        return asked

    def test_a_plant_that_diverges_is_drawn_anew(self, monkeypatch):
        assert self.draw_of(monkeypatch, finite_from=1) == [14]
        again = self.draw_of(monkeypatch, finite_from=3)
        assert len(again) == 3 and {index % 4 for index in again} == {14 % 4}  # a null stays a null

    def test_plants_that_all_diverge_are_an_error(self, monkeypatch):
        with pytest.raises(OverflowError, match="open 7000/14: 5 plants that diverge"):
            self.draw_of(monkeypatch, finite_from=99)


class TestFreeze:
    @pytest.fixture
    def tree(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
        tree = tmp_path / "tree"
        tree.mkdir()
        monkeypatch.setattr(running, "HERE", tree)
        for name in ("AUTHOR", "COMMITTER"):
            monkeypatch.setenv(f"GIT_{name}_NAME", "a")
            monkeypatch.setenv(f"GIT_{name}_EMAIL", "a@b")
        (tree / "engine.py").write_text("one\n")
        self.git(tree, "init", "-q")
        self.commit(tree)
        return tree

    def git(self, tree: Path, *arguments: str) -> None:
        subprocess.run(["git", *arguments], cwd=tree, check=True)

    def commit(self, tree: Path) -> None:
        self.git(tree, "add", "-A")
        self.git(tree, "commit", "-qm", "x")

    def test_seeds_hold_the_commit_the_date_and_a_seed_a_track_above_those_for_development(self, tree):
        seeds = draw_seeds(tree / "seeds.json", dict.fromkeys(PROOF, 5))
        assert json.loads((tree / "seeds.json").read_text()) == seeds
        assert len(seeds["commit"]) == 40 and seeds["drawn"].startswith("20")
        assert set(seeds["seeds"]) == set(PROOF) and all(seed >= 10_000 for seed in seeds["seeds"].values())
        assert len(set(seeds["seeds"].values())) == len(PROOF)

    def test_seeds_for_development_are_below_those_that_are_drawn(self):
        assert set(development_seeds(9999, 3)["counts"].values()) == {3}
        with pytest.raises(RunError, match="found 10000, expected 0 to 9999"):
            development_seeds(10_000, 3)

    @pytest.mark.parametrize("file", ["engine.py", "new.py"])
    def test_seeds_are_drawn_from_a_committed_tree_and_once(self, tree, file):
        (tree / file).write_text("two\n")
        with pytest.raises(RunError, match=f"found changes in {file}"):
            draw_seeds(tree / "seeds.json", {"alien": 5})
        self.commit(tree)
        draw_seeds(tree / "seeds.json", {"alien": 5})
        self.commit(tree)
        with pytest.raises(RunError, match="seeds are drawn once"):
            draw_seeds(tree / "seeds.json", {"alien": 5})

    def test_the_run_goes_with_the_frozen_tree_and_its_own_files_and_with_no_other(self, tree):
        seeds = draw_seeds(tree / "seeds.json", {"alien": 5})
        own = [tree / "seeds.json", tree / "out"]
        (tree / "out").mkdir()
        (tree / "out" / "results.json").write_text("{}")
        check_frozen(seeds, own)
        self.commit(tree)  # of the seeds
        check_frozen(seeds, own)
        (tree / "engine.py").write_text("two\n")
        for commit in (False, True):
            if commit:
                self.commit(tree)
            with pytest.raises(RunError, match="found changes in engine"):
                check_frozen(seeds, own)

    def test_the_command_refuses_another_tree_unless_told(self, tree, tmp_path, monkeypatch):
        draw_seeds(tree / "seeds.json", dict.fromkeys(PROOF, 1))
        (tree / "engine.py").write_text("two\n")
        with pytest.raises(SystemExit, match="concealed run: expected the tree of commit"):
            main(["run", str(tree / "seeds.json"), "--output", str(tmp_path / "out")])

    def test_a_tool_that_is_not_there_is_named_before_any_case(self, tmp_path):
        with pytest.raises(SystemExit, match="entry mine: found no program 'mine-tool', expected it on PATH"):
            main(["run", "--name", "mine", "--diagnose", "mine-tool {recordings}", "--output", str(tmp_path)])
        assert not list(tmp_path.iterdir())


def test_it_imports_nothing_of_torchpi_and_little_else():
    allowed = {"numpy", "scipy", "numba", "matplotlib", "distributed", "concealed", *sys.stdlib_module_names}
    for file in PACKAGE.rglob("*.py"):
        for node in ast.walk(ast.parse(file.read_text())):
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            if isinstance(node, ast.ImportFrom):
                assert node.level == 0
                names = [node.module]
            assert {name.split(".")[0] for name in names} <= allowed, file


def test_cases_are_generated_with_their_labels_apart(tmp_path, capsys):
    main(
        [
            "generate",
            "--track",
            "alien",
            "--seed",
            "7000",
            "--first",
            "4",
            "--count",
            "1",
            "--output",
            str(tmp_path),
        ]
    )
    given = {path.name for path in (tmp_path / "alien" / "case_0004").iterdir()}
    assert given == {"a.csv", "b.csv", "c.csv", "d.csv", "heldout_input.csv"}
    sealed = {path.name for path in (tmp_path / "alien" / "sealed").iterdir()}
    assert sealed == {"case_0004.json", "case_0004_heldout.csv"}
    header = (tmp_path / "alien" / "case_0004" / "heldout_input.csv").read_text().split("\n")[0]
    assert "output_um" not in header and "resonance" not in capsys.readouterr().out
