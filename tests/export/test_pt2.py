"""The `.pt2` file: loaded by torch alone, a pure function with the bits of the stream."""

import json
import math
from pathlib import Path

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
