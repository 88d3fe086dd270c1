"""The play (backlash) operator as one scalar equation, Qin et al. (2013), eq. 1 and 2."""


def play(x: float, r: float, h: float) -> float:
    """One step of a play: h(t) = max{x(t) - r, min{x(t) + r, h(t - T)}}.

    This is eq. 1. At the first sample `h` is the initial state h0, which makes it eq. 2. This one function
    is what the kernels, the stream and the exports compile.
    """
    return max(x - r, min(x + r, h))
