"""The `.pt2` file: loaded by torch alone, a pure function with the bits of the stream."""

import json
import math
import os
import re
import shutil
from pathlib import Path
from typing import Any

import pytest
import torch

from tests.control.test_corrected import corrected
from tests.control.test_direct_inverse import compensator, trajectory
from torchpi.export import export_files
from torchpi.export.deployable import Deployable
from torchpi.operators import ReferenceFilter

pytestmark = [
    # Raised within torch during torch.export.
    pytest.mark.filterwarnings("ignore::DeprecationWarning"),
    pytest.mark.filterwarnings("ignore::FutureWarning"),
]

PAGE = (Path(__file__).parents[2] / "exports" / "README.md").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("made", "filter_"),
    [(compensator(), None), (compensator(lead=0), ReferenceFilter(1e-4)), (corrected(1), None)],
)
def test_loaded_program_has_the_bits_of_the_stream(
    made: Deployable, filter_: ReferenceFilter | None, tmp_path: Path
) -> None:
    export_files(made, tmp_path / "demo", ("pt2",), filter_)
    extra = {"contract.json": ""}
    program = torch.export.load(tmp_path / "demo.pt2", extra_files=extra)
    contract, step = json.loads(extra["contract.json"]), program.module()
    stream = made.stream(filter_)
    assert contract["sample_period_s"] == stream.sample_period_s and contract["preview"] == stream.preview
    state = program.state_dict["initial_state"]
    assert state.tolist() == contract["initial_state"]
    yd = 1 + trajectory(40)
    yd[7], yd[8] = math.nan, math.inf
    voltages = []
    for sample in yd:
        u, after = step(sample, state)
        again, _ = step(sample, state)
        assert torch.equal(u, again)
        voltages.append(u)
        state = after
    assert torch.equal(torch.stack(voltages), stream.block(yd))
    assert state[contract["state"].index("held_inputs")] == 2


@pytest.mark.long
@pytest.mark.skipif(shutil.which(os.environ.get("CXX", "g++")) is None, reason="needs a C++ compiler, g++")
def test_aotinductor_code_compiled_as_on_the_page_gives_the_same_voltages(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("TORCHINDUCTOR_CACHE_DIR", str(tmp_path / "cache"))
    made = compensator(thresholds=[0.0, 1.0, 2.0])  # the time to compile grows with the number of plays
    export_files(made, Path("exports/demo"), ("pt2",))
    (block,) = (one for one in re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL) if "aoti_compile" in one)
    names: dict[str, Any] = {}
    exec(compile(block, "exports/README.md", "exec"), names)
    step, state, voltages = names["step"], names["program"].state_dict["initial_state"], []
    yd = 1 + trajectory(40)
    yd[7], yd[8] = math.nan, math.inf
    for sample in yd:
        u, state = step(sample, state)
        voltages.append(u)
    exact = tuple(map(int, torch.__version__.split(".")[:2])) >= (2, 13)
    assert torch.allclose(
        torch.stack(voltages), made.stream().block(yd), rtol=0.0 if exact else 1e-12, atol=0.0
    )
