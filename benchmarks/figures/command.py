"""Measure the figures that README and docs quote, record them in docs/figures.json, renew the pages.

    python -m benchmarks.figures [--only commission,demo] [--short] [--again] [--list]

Measurements made with the current code are kept, so that an interrupted run continues where it stopped. Each
measurement is recorded as soon as it is made. Numbers on the pages are then replaced by those measured. A
figure outside its bound is recorded too, but is named at the end, with exit code 1, because the words around
it may no longer be true.
"""

import argparse
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path

from benchmarks.figures import pages, record, table
from benchmarks.figures.figure import Figure, Measurement
from benchmarks.figures.measurements import DATA
from benchmarks.figures.registry import FIGURES, MEASUREMENTS
from torchpi.files import write_atomically


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--only", default="", help="names of measurements, with commas between them")
    parser.add_argument("--short", action="store_true", help="those that the tests make as well")
    parser.add_argument("--again", action="store_true", help="measure again what was measured with this code")
    parser.add_argument("--list", action="store_true", help="print what would be measured, and end")
    options = parser.parse_args()
    names = [name for name in options.only.split(",") if name]
    unknown = set(names) - {one.name for one in MEASUREMENTS}
    if unknown:
        expected = ", ".join(one.name for one in MEASUREMENTS)
        print(f"--only: found {', '.join(sorted(unknown))}, expected some of {expected}", file=sys.stderr)
        return 2
    chosen = [
        one for one in MEASUREMENTS if (one.name in names or not names) and (one.short or not options.short)
    ]
    code = record.code_sha256()
    due = chosen if options.again else [one for one in chosen if not measured(one, record.read(), code)]
    print(f"{len(chosen) - len(due)} of {len(chosen)} measurements stand; {estimate(due)}")
    if options.list:
        for one in due:
            print(f"  {one.name}: {one.command}, about {one.about_s:.0f} s")
        return 0
    failed = measure(due, code, print)
    record.write(record.registered(record.read(), FIGURES))
    with write_atomically(table.PAGE) as temporary:
        temporary.write_text(table.page(MEASUREMENTS, record.read()), encoding="utf-8")
    for path in renewed(FIGURES):
        print(f"{path}: numbers renewed; read the words around them")
    failed += outside(FIGURES, record.values(record.read()))
    for text in failed:
        print(text, file=sys.stderr)
    return 1 if failed else 0


def measured(one: Measurement, found: record.Record, code: str) -> bool:
    """Whether all figures of a measurement were measured with this code."""
    return all(found.get(figure.name, {}).get("code_sha256") == code for figure in one.figures)


def estimate(due: Sequence[Measurement]) -> str:
    """Say in words how long these measurements will take."""
    seconds = sum(one.about_s for one in due)
    time_left = f"{seconds:.0f} s" if seconds < 120 else f"{seconds / 60:.0f} minutes"
    return f"{len(due)} to make, about {time_left}"


def measure(
    due: Sequence[Measurement], code: str, log: Callable[[str], None], path: Path = record.RECORD
) -> list[str]:
    """Make these measurements and record each as soon as it is made.

    Args:
        due: What to measure.
        code: Hash of the code, for the record.
        log: Called with lines of progress.
        path: The record.

    Returns:
        One line for each measurement that failed; its figures stay as they were.
    """
    failed, left_s = [], sum(one.about_s for one in due)
    for count, one in enumerate(due, 1):
        log(f"[{count}/{len(due)}] {one.name}: about {one.about_s:.0f} s, {left_s:.0f} s to the end")
        left_s -= one.about_s
        if one.needs_recordings and not DATA.is_dir():
            log("    left out: the recordings of real stages are not beside this checkout")
            continue
        start = time.perf_counter()
        try:
            found = one.values()
        except Exception as error:  # a failure must not keep the others from being measured
            failed.append(f"{one.name}: {' '.join(str(error).split())}")
            log(f"    failed: {failed[-1]}")
            continue
        record.write(record.read(path) | record.entries(one, found, code), path)
        for figure in one.figures:
            value = figure.quoted(found[figure.name]) + figure.unit_behind
            log(f"    {figure.name}: {value}, bound {figure.bound}")
        log(f"    {time.perf_counter() - start:.0f} s")
    return failed


def renewed(figures: dict[str, Figure]) -> list[str]:
    """Replace the numbers on all pages by those of the record; return the pages that changed."""
    values, changed = record.values(record.read()), []
    for path in pages.pages():
        text = pages.renew(path, figures, values)
        if text != path.read_text(encoding="utf-8"):
            with write_atomically(path) as temporary:
                temporary.write_text(text, encoding="utf-8")
            changed.append(path.relative_to(pages.ROOT).as_posix())
    return changed


def outside(figures: dict[str, Figure], values: dict[str, float]) -> list[str]:
    """Return one line for each value outside its bound."""
    return [
        f"{name}: found {value:g}, expected {figures[name].bound}"
        for name, value in values.items()
        if name in figures and not figures[name].within(value)
    ]
