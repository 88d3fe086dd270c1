"""Where to put the thresholds when the user does not say."""

# The paper's rig: r = [0 .05 .1 .2 .3 .5 1 1.5 2 3] for S up to 10.8. A play nearly as wide as half of the
# range hardly moves after the first loading: it cannot be told from an offset. Denser near 0, where the
# loop bends most.
LARGEST = 0.3
DENSER = 2.0


def spread_thresholds(plays: int, peak_to_peak_um: float) -> list[float]:
    """r_i from 0 to 0.3 of the range, their distance growing in proportion to i."""
    return [LARGEST * peak_to_peak_um * (i / max(plays - 1, 1)) ** DENSER for i in range(plays)]
