"""The mutation check: what it changes, what it leaves alone, and which mutants survive."""

from pathlib import Path

import pytest

from benchmarks.mutations import GUARDS, ROOT, mutants, survivors

SOURCE = '''
def limited(x: float, most: float = 2.0) -> float:
    """Doubled, but no more than `most`."""
    if not x > 0:
        raise ValueError(f"found {x + 1}")
    return min(2 * x, most)
'''


def test_each_kind_of_mutation_is_made_but_none_in_types_or_messages() -> None:
    found = [what for what, _ in mutants(SOURCE)]
    assert found == [
        "2: constant: 2.0  ->  5.0",
        "4: never: if not x > 0:  ->  if False:",
        "4: sign dropped: not x > 0  ->  x > 0",
        "4: negated: x > 0  ->  x <= 0",
        "4: boundary: x > 0  ->  x >= 0",
        "4: constant: 0  ->  1",
        "6: bound dropped: min(2 * x, most)  ->  2 * x",
        "6: min, max: min(2 * x, most)  ->  max(2 * x, most)",
        "6: operator: 2 * x  ->  2 / x",
        "6: term dropped: 2 * x  ->  2",
        "6: constant: 2  ->  5",
    ]


def test_a_condition_among_several_is_dropped_or_its_operator_swapped() -> None:
    found = [what for what, _ in mutants("kept = [x for x in every if x and y]\n")]
    assert [what.partition(": ")[2].partition(":")[0] for what in found] == [
        "condition dropped",
        "and, or",
        "condition dropped",
        "condition dropped",
    ]


def test_a_mutant_that_no_test_detects_survives(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "made_up.py").write_text("def positive(x):\n    return x > 0\n")
    guard = tmp_path / "test_made_up.py"
    guard.write_text("from made_up import positive\n\n\ndef test():\n    assert positive(3)\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.setenv("PYTEST_DISABLE_PLUGIN_AUTOLOAD", "1")
    left = [what for what, survives in survivors("made_up", [str(guard)]) if survives]
    assert left == ["2: boundary: x > 0  ->  x >= 0", "2: constant: 0  ->  1"]
    guard.write_text("def test():\n    assert False\n")
    with pytest.raises(SystemExit, match="made_up: its tests fail as it stands"):
        next(survivors("made_up", [str(guard)]))


def test_every_guarding_test_file_exists() -> None:
    assert all((ROOT / "tests" / guard).is_file() for guards in GUARDS.values() for guard in guards)
