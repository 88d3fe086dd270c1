"""The motion that the tests of the inverses share."""

import pytest

from torchpi.operators.conformance import wandering
from torchpi.operators.motion import Motion, backward_motion

PERIOD_S = 1e-4


@pytest.fixture
def motion() -> Motion:
    """Return two random trajectories of 0 to a few µm, with rates as computed in a control loop."""
    yd = 2.5 + wandering(2, 3000, seed=1)
    return backward_motion(yd, PERIOD_S)
