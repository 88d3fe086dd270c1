"""The run: one frozen commit, one file of seeds, and every case recorded, whatever the executor."""

import json
import secrets
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from concurrent.futures import Executor, ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from concealed.cases import Case, write_given, write_recordings
from concealed.entries import Entry, RunError, ask
from concealed.judging.grade import Grade, grade
from concealed.judging.summary import summarise
from concealed.real.case import untouched_recordings
from concealed.real.grade import grade_injected
from concealed.tracks import PROOF, draw

HERE = Path(__file__).parent
FIRST_SEED, SEEDS = 10_000, 2**31 - 20_000  # lower seeds are for development


@dataclass(frozen=True)
class Job:
    """One case, or the untouched recordings that cases on real recordings are compared with."""

    track: str
    seed: int
    number: int
    entry: Entry
    data: Path
    untouched: str = ""
    """If set, the job is not a case but the untouched recordings of this name."""
    before: object = None
    """The diagnosis of the untouched recordings."""

    @property
    def name(self) -> str:
        """Name of the file of its record."""
        return self.untouched or f"{self.track}_{self.number:04d}"


def draw_seeds(output: Path, counts: dict[str, int]) -> dict[str, object]:
    """Write seeds that nobody could know when the commit was made. The tree has to be clean."""
    commit, changed = _git("rev-parse", "HEAD").strip(), _changed("HEAD", [])
    if changed:
        raise RunError(f"seeds are drawn from a committed tree: found changes in {', '.join(changed[:5])}")
    if output.exists():
        raise RunError(f"{output}: found a file, expected none: seeds are drawn once")
    seeds = {
        "commit": commit,
        "drawn": datetime.now(UTC).isoformat(timespec="seconds"),
        "seeds": {track: FIRST_SEED + secrets.randbelow(SEEDS) for track in counts},
        "counts": counts,
    }
    output.parent.mkdir(parents=True, exist_ok=True)
    output.write_text(json.dumps(seeds, indent=1) + "\n")
    return seeds


def development_seeds(seed: int, count: int) -> dict[str, object]:
    """Return the same seed for every track, for a tree that may change; the results are not to be quoted."""
    if not 0 <= seed < FIRST_SEED:
        raise RunError(f"seed: found {seed}, expected 0 to {FIRST_SEED - 1}: the others are drawn")
    every = dict.fromkeys(PROOF, seed)
    return {"commit": "development", "drawn": None, "seeds": every, "counts": dict.fromkeys(PROOF, count)}


def check_frozen(seeds: dict, allowed: Sequence[Path]) -> None:
    """Refuse a tree that differs from the commit of the seeds, except in the files of the run itself."""
    changed = _changed(seeds["commit"], allowed)
    if changed:
        raise RunError(
            f"expected the tree of commit {seeds['commit'][:12]}: found changes in {', '.join(changed[:5])}"
        )


def _changed(commit: str, allowed: Sequence[Path]) -> list[str]:
    top = Path(_git("rev-parse", "--show-toplevel").strip())
    names = _git("diff", "--name-only", commit).splitlines()
    names += _git("-C", str(top), "ls-files", "--others", "--exclude-standard").splitlines()
    apart = [path.resolve() for path in allowed]
    return [n for n in names if not any((top / n).resolve().is_relative_to(path) for path in apart)]


def _git(*arguments: str) -> str:
    done = subprocess.run(["git", *arguments], cwd=HERE, capture_output=True, text=True)
    if done.returncode:
        raise RunError(f"git {arguments[0]}: {done.stderr.strip()}")
    return done.stdout


def open_executor(text: str) -> Executor:
    """Open `processes:N` here, or `dask:ADDRESS`, a cluster whose workers have this package and the tool."""
    kind, _, where = text.partition(":")
    if kind == "processes":
        return ProcessPoolExecutor(int(where or 1))
    if kind == "dask":
        from distributed import Client

        return Client(where).get_executor()
    raise RunError(f"executor: found {text!r}, expected processes:N or dask:ADDRESS")


def run(
    seeds: dict,
    entry: Entry,
    output: Path,
    executor: Executor,
    data: Path,
    tracks: Sequence[str] = PROOF,
    limit: int | None = None,
) -> dict[str, object]:
    """Submit every case that has no record yet to the tool, then write OUTPUT/results.json.

    An interrupted run is continued. Records of another commit, seed or command are refused.
    """
    counts = {track: min(seeds["counts"][track], limit or sys.maxsize) for track in tracks}
    jobs = [
        Job(track, seeds["seeds"][track], number, entry, data)
        for track in tracks
        for number in range(1, counts[track] + 1)
    ]
    stamp = {"commit": seeds["commit"], "diagnose": entry.diagnose, "predict": entry.predict}
    before = {job.untouched: job for job in map(_untouched_of, jobs) if job is not None}
    _work(list(before.values()), output, executor, stamp)
    answers = {name: _record(output, name, stamp)["diagnosis"] for name in before}
    graded = [_with_before(job, answers) for job in jobs]
    _work(graded, output, executor, stamp)
    records = {job.name: _record(output, job.name, stamp) for job in jobs}
    grades = [Grade(**record["grade"]) for record in records.values()]
    summary = summarise(grades)
    results = {
        **stamp,
        "entry": entry.name,
        "drawn": seeds.get("drawn"),
        "seeds": {track: seeds["seeds"][track] for track in tracks},
        "counts": counts,
        **summary,
        "said": {name: _said(records[name.replace("/case", "")]) for name in summary["stories"]},
        "cases": [grade.as_dict() for grade in grades],
    }
    (output / "results.json").write_text(json.dumps(results, indent=1, allow_nan=False) + "\n")
    return results


def _said(record: dict) -> str:
    """Return a tool's answer in words, or '' if there are none."""
    answer = record["diagnosis"]
    return str(answer.get("says", "")) if isinstance(answer, dict) else ""


def _untouched_of(job: Job) -> Job | None:
    if job.track != "noise" or job.number % 2 == 0:
        return None
    source, with_aux = untouched_recordings(job.seed, (job.number - 1) // 2)
    name = f"untouched_{job.seed}_{source}" + "_with_aux" * with_aux
    return Job(job.track, job.seed, job.number, job.entry, job.data, untouched=name)


def _with_before(job: Job, answers: dict[str, object]) -> Job:
    untouched = _untouched_of(job)
    if untouched is None:
        return job
    return Job(job.track, job.seed, job.number, job.entry, job.data, before=answers[untouched.untouched])


def _work(jobs: list[Job], output: Path, executor: Executor, stamp: dict) -> None:
    """Do the jobs that have no record, and print progress with the estimated time left."""
    folder = output / "records"
    folder.mkdir(parents=True, exist_ok=True)
    open_jobs = [job for job in jobs if _record(output, job.name, stamp) is None]
    started = time.monotonic()
    futures = {executor.submit(work, job): job for job in open_jobs}
    for done, future in enumerate(as_completed(futures), 1):
        job, record = futures[future], future.result()
        part = folder / f"{job.name}.part"
        part.write_text(json.dumps(stamp | record) + "\n")
        part.replace(folder / f"{job.name}.json")
        left = (time.monotonic() - started) / done * (len(open_jobs) - done)
        line = f"{done}/{len(open_jobs)} {job.name}: {record['diagnose_s']:.0f} s"
        line += " failed" * bool(record["failure"])
        print(f"{line}; about {left / 60:.0f} min left", file=sys.stderr, flush=True)


def _record(output: Path, name: str, stamp: dict) -> dict | None:
    path = output / "records" / f"{name}.json"
    if not path.exists():
        return None
    record = json.loads(path.read_text())
    for key, expected in stamp.items():
        if record[key] != expected:
            raise RunError(f"{path}: found {key} {record[key]!r}, expected {expected!r}")
    return record


def work(job: Job) -> dict[str, object]:
    """Draw one case, submit it to the tool and grade the answer. No label is written where the tool runs."""
    case = draw(job.track, job.seed, job.number - 1, job.data)
    with tempfile.TemporaryDirectory(prefix="concealed_") as name:
        folder = Path(name)
        if job.untouched:
            write_recordings(case.untouched, folder / "given")
        else:
            write_given(case, folder / "given")
        answer = ask(job.entry, folder / "given", folder / "out")
    record = {"diagnosis": answer.diagnosis, "diagnose_s": answer.diagnose_s, "failure": answer.failure}
    return record if job.untouched else record | {"grade": _grade(case, job, answer).as_dict()}


def _grade(case: Case, job: Job, answer) -> Grade:
    labels = {"case": f"case_{job.number:04d}", **case.labels}
    if case.heldout is None:
        return grade_injected(labels, answer.diagnosis, job.before, diagnose_s=answer.diagnose_s)
    return grade(
        labels,
        answer.diagnosis,
        predicted_um=answer.predicted_um,
        measured_um=case.heldout["output_um"],
        diagnose_s=answer.diagnose_s,
    )
