"""Reproduce the whole paper or parts of it: each result is stored at once, one page is written at the end."""

import hashlib
import json
import sys
import time
from collections.abc import Iterable, Iterator
from difflib import get_close_matches
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    SpinnerColumn,
    TextColumn,
    TimeElapsedColumn,
)

import torchpi
from torchpi.errors import ConfigError
from torchpi.files import check_output_folder, config_file, write_text
from torchpi.paper.context import FULL, RECIPE, Context, Item, Recipe, Size
from torchpi.paper.items import ITEMS
from torchpi.paper.stored import restore, store
from torchpi.report.paper_page import Section, write_paper_page
from torchpi.report.what_was_run import provenance
from torchpi.stage import Stage

DEFAULT_STAGE = Path("qin2013")
# Packages that results do not depend on, so that a change of the page needs no new computation.
NOT_COMPUTING = ("report", "export", "cli", "loop", "commission")


def reproduce(
    output: Path = Path("exports/paper"),
    only: list[str] | None = None,
    stage: Path = DEFAULT_STAGE,
    size: Size = FULL,
    recipe: Recipe = RECIPE,
) -> Path:
    """Compute the missing results, and write `paper.html` and `results.json` into `output`.

    Every result is kept in `output/items` under a hash of its inputs, so that an interrupted run continues
    where it stopped. The page shows all available results in the order of the paper.

    Args:
        output: Folder, created if necessary.
        only: Names of figures and experiments to compute with their prerequisites; None for all.
        stage: Stage file of the simulated rig.
        size: Extent of the computation; the whole by default.
        recipe: How torchpi's compensators are learned.

    Returns:
        Path of the page.

    Raises:
        ConfigError: A name is unknown (the message lists the known ones), or the stage file is invalid.
        StageError: The stage has an unphysical value.
        ArtifactError: `output` cannot be written to.
    """
    names = chosen(only)
    check_output_folder(output)
    plant = Stage.from_yaml(stage)
    plant.requires_grad_(False)
    keys = _keys(plant, size, recipe)
    done: dict[str, Any] = {}
    seconds: dict[str, float] = {}

    def take(name: str) -> bool:
        """Restore a stored result; return whether there was one."""
        found: tuple[Any, float] | None = restore(ITEMS[name].result, keys[name], _file(output, name))
        if found is not None:
            done[name], seconds[name] = found
        return found is not None

    items = list(_with_needs(names))
    with _progress() as progress:
        task = progress.add_task("", total=len(items))
        for name in items:
            progress.update(task, description=name)
            if not take(name):
                start = time.perf_counter()
                done[name] = ITEMS[name].compute(Context(plant, recipe, size, done))
                seconds[name] = time.perf_counter() - start
                store(done[name], keys[name], seconds[name], _file(output, name))
                progress.console.print(f"{name:12} {seconds[name]:6.1f} s")
            progress.advance(task)
        progress.update(task, description="page")
        # The page also shows results that an earlier run computed for the same stage.
        for name in ITEMS:
            if name not in done:
                take(name)
        return _write(output, stage, done, seconds)


def chosen(only: Iterable[str] | None) -> list[str]:
    """Return the checked names, or all names for None.

    Raises:
        ConfigError: A name is unknown.
    """
    names = list(ITEMS) if only is None else list(only)
    for name in names:
        if name not in ITEMS:
            near = get_close_matches(name, list(ITEMS), n=1)
            guess = f", perhaps '{near[0]}'" if near else ""
            raise ConfigError(f"only: no figure '{name}'{guess}; available: {', '.join(ITEMS)}")
    if not names:
        raise ConfigError(f"only: found no name, expected one or more of: {', '.join(ITEMS)}")
    return names


def _with_needs(names: list[str]) -> Iterator[str]:
    """Yield the names and their prerequisites, prerequisites first, each once."""
    seen: set[str] = set()

    def visit(name: str) -> Iterator[str]:
        if name not in seen:
            seen.add(name)
            for need in ITEMS[name].needs:
                yield from visit(need)
            yield name

    for name in names:
        yield from visit(name)


def _keys(plant: Stage, size: Size, recipe: Recipe) -> dict[str, str]:
    """Return a hash for each item of everything that its result depends on."""
    code = _code_hash()
    learned = [f"{one.__module__}.{one.__qualname__}" for one in (recipe.fig7, recipe.stage)]
    settings = plant.to_dict()

    def key(item: Item) -> str:
        of_stage = settings if item.of_the_stage or _any_needs_the_stage(item) else None
        inputs = json.dumps([item.name, repr(size), learned, of_stage, code], sort_keys=True)
        return hashlib.sha256(inputs.encode()).hexdigest()

    return {name: key(item) for name, item in ITEMS.items()}


def _any_needs_the_stage(item: Item) -> bool:
    return any(ITEMS[need].of_the_stage or _any_needs_the_stage(ITEMS[need]) for need in item.needs)


def _code_hash() -> str:
    """Hash the source of the package without the parts that do not affect results."""
    root = Path(torchpi.__file__).parent
    digest = hashlib.sha256()
    for path in sorted(root.rglob("*.py")):
        relative = path.relative_to(root)
        if relative.parts[0] not in NOT_COMPUTING:
            digest.update(str(relative).encode() + path.read_bytes())
    return digest.hexdigest()


def _file(output: Path, name: str) -> Path:
    return output / "items" / f"{name}.npz"


def _progress() -> Progress:
    return Progress(
        SpinnerColumn(),
        TextColumn("{task.description:12}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        console=Console(stderr=True),
        disable=not sys.stderr.isatty(),  # a log file then holds only errors
    )


def _write(output: Path, stage: Path, done: dict[str, Any], seconds: dict[str, float]) -> Path:
    numbers: dict[str, Any] = {}
    sections = []
    for name in ITEMS:
        if name in done:
            _merge(numbers, done[name].numbers())
            sections.append(Section(name, done[name], done[name].rows(), seconds[name]))
    text = json.dumps(numbers, indent=1, ensure_ascii=False, allow_nan=False)
    write_text(output / "results.json", text + "\n")
    about = provenance(" ".join(["torchpi", *sys.argv[1:]]), {"stage": config_file(stage, "stage")})
    return write_paper_page(sections, [name for name in ITEMS if name not in done], about, output)


def _merge(into: dict[str, Any], more: dict[str, Any]) -> None:
    for key, value in more.items():
        if isinstance(value, dict) and key in into:
            _merge(into[key], value)
        else:
            into[key] = value
