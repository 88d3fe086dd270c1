"""The recipe of `configs/recorded.yaml`: least squares on plays of the displacement, with selected form."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from torch import Tensor

from torchpi.control.direct_inverse import DirectInverse
from torchpi.control.trained_motions import TrainedMotions
from torchpi.identification.pair import InversePair
from torchpi.identification.selection import Form, Pairs, Richest, Selection, select_form

# The paper's rig has r = [0 .05 .1 .2 .3 .5 1 1.5 2 3] for S up to 10.8. A play nearly as wide as half of the
# range hardly moves after the first loading, so it cannot be told from an offset. Thresholds are denser near
# 0, where the loop bends most.
LARGEST = 0.3
DENSER = 2.0
MOST_SAMPLES = 1_000_000  # quantiles are computed from about this many samples
MOST_PREVIEW = 64  # samples of look-ahead that are tried
PLAYS = 20
RECORDED = Richest(
    previews=range(MOST_PREVIEW + 1),
    degree=4,
    lead=2,
    creep_time_constants_s=(0.1, 1.0, 10.0),
    rate=True,
)
"""Default limits of the selection."""


class Recipe:
    """Build compensators for the records that they are trained on.

    Args:
        pairs: The records, without look-ahead.
        plays: Number of thresholds to spread over the range of the records.
        thresholds: r of the plays; if None, they are spread.
        options: Further arguments of `DirectInverse`.
    """

    def __init__(
        self,
        pairs: Sequence[InversePair],
        plays: int = PLAYS,
        thresholds: Sequence[float] | None = None,
        **options: Any,
    ) -> None:
        y = torch.cat([pair.motion.yd[0, pair.counted] for pair in pairs])
        rates = torch.cat([pair.motion.yd_dot[0, pair.counted] for pair in pairs])
        self.plays, self.thresholds = plays, None if thresholds is None else list(thresholds)
        self.usual_um = usual_range_um(y)
        self.common: dict[str, Any] = dict(
            sample_period_s=pairs[0].sample_period_s,
            thresholds=self.thresholds or spread_thresholds(plays, float(y.max() - y.min())),
            range_um=float(y.abs().max()),
            rate_scale_um_s=float(rates.abs().max()),
            trained=TrainedMotions.of(pairs).plain(),
            **options,
        )

    def of_form(self, form: Form) -> DirectInverse:
        """Return an unfitted compensator of this form."""
        options = {name: value for name, value in vars(form).items() if name != "spread"}
        grid = self.thresholds or spread_thresholds(self.plays, self.usual_um, form.spread)
        return DirectInverse(**{**self.common, **options, "thresholds": grid})

    def select(self, pairs_seen_ahead: Pairs, richest: Richest = RECORDED) -> Selection:
        """Select the form that generalises best over the records, and fit it to them.

        Args:
            pairs_seen_ahead: Function that returns the records for a number of samples of look-ahead.
            richest: Limits of the selection; thresholds that were given are not spread.
        """
        spreads = richest.spreads[:1] if self.thresholds else richest.spreads
        allowed = Richest(**{**vars(richest), "spreads": spreads})
        return select_form(lambda form, _: self.of_form(form), pairs_seen_ahead, allowed)


def spread_thresholds(plays: int, peak_to_peak_um: float, largest: float = LARGEST) -> list[float]:
    """Return r_i from 0 to `largest` times the range, with spacing that grows in proportion to i."""
    return [largest * peak_to_peak_um * (i / max(plays - 1, 1)) ** DENSER for i in range(plays)]


def usual_range_um(yd: Tensor) -> float:
    """Return the 1 % to 99 % quantile range: a play that only the rarest peaks move acts as an offset."""
    thinned = yd[:: max(1, len(yd) // MOST_SAMPLES)]
    low, high = np.quantile(thinned.numpy(), [0.01, 0.99])
    return float(high - low)
