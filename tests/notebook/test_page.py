"""The code of the notebook page runs as it stands and is as short as promised."""

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

PAGE = (Path(__file__).parents[2] / "docs" / "notebook.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)


def test_from_arrays_to_a_tracked_trajectory_takes_at_most_fifteen_lines() -> None:
    lines = [line for line in BLOCKS[1].splitlines() if line.strip()]
    assert "from_arrays" in BLOCKS[1] and "track" in BLOCKS[1] and "plot" in BLOCKS[1]
    assert len(lines) <= 15


@pytest.mark.long
def test_the_page_runs_in_an_empty_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    names: dict[str, Any] = {}
    for block in BLOCKS:
        exec(compile(block, "docs/notebook.md", "exec"), names)
    result = names["result"]
    assert 3 * result.rms_um < result.without.on_true.whole.rms_um
    assert np.allclose(names["voltage"], result.u_v)
    assert np.allclose(result.error_um, result.y_um - names["reference"])
    assert {"mine.pt", "mine.c", "mine.html", "mine_stage.pt"} <= {p.name for p in Path("exports").iterdir()}
    assert np.allclose(names["recording"].y, names["measured"][0][2])
