"""The play (backlash) operator as one scalar equation, Qin et al. (2013), eq. 1 and 2."""


def play(x: float, r: float, h: float) -> float:
    """One step of a play: h(t) = max{x(t) - r, min{x(t) + r, h(t - T)}}.

    This is eq. 1. At the first sample `h` is the initial state h0, which makes it eq. 2. The kernels,
    the stream and the exports all compile this one function.

    Args:
        x: Input, in any unit.
        r: Threshold, in the unit of x.
        h: State after the previous sample, in the unit of x.

    Example:
        >>> from torchpi.operators import play
        >>> [play(x, r=0.5, h=0.0) for x in (0.2, 1.0, -1.0)]
        [0.0, 0.5, -0.5]
    """
    return max(x - r, min(x + r, h))
