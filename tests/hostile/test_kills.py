"""A command that is killed leaves previous files whole, nothing running, and the next run succeeds.

`benchmarks/kills.py` does it for more commands, and at more moments.
"""

from pathlib import Path

import pytest

from tests.hostile.kills import SIGNALS, commands, kill_often


@pytest.mark.long
@pytest.mark.skipif(not Path("/proc/self/task").is_dir(), reason="children are found in /proc")
@pytest.mark.parametrize("name", ["fit", "export"])
def test_a_killed_command_leaves_whole_files_and_the_next_run_succeeds(name: str, tmp_path: Path) -> None:
    outcome = kill_often(commands(tmp_path)[name], rounds=1, finish_every=len(SIGNALS))
    assert outcome.faults == [] and sum(outcome.kills.values()) > 0
