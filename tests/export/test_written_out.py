"""The step as exported to TorchScript: unrolled, and without code for parts that a compensator lacks."""

import inspect

from tests.control.test_corrected import corrected
from tests.control.test_direct_inverse import compensator
from torchpi.control.direct_inverse import DirectInverse
from torchpi.export.written_out import written_out


def text(made: DirectInverse) -> str:
    step = written_out(made.stream())
    return "".join(inspect.getsource(one) for one in vars(type(step)).values() if callable(one))


def test_loops_are_unrolled_into_readable_code() -> None:
    source = text(compensator())
    assert "h = play(s, self.r_9, self.h_9)" in source and "phi_1 = squash(" in source
    assert "for " not in source and "self.phi" not in source


def test_parts_that_a_compensator_lacks_are_absent_from_its_step() -> None:
    bare = compensator(rate="none", lead=0, creep_time_constants_s=[], output_degree=1, offset=False)
    source = text(bare)
    assert not any(name in source for name in ("self.xi", "phi", "self.k_", "psi"))


def test_a_nested_step_is_unrolled_as_well() -> None:
    stream = written_out(corrected(1).stream())
    names = [type(one).__name__ for one in stream.modules()]
    assert names.count("WrittenOut") == 2 and "DirectInverseStream" not in names
