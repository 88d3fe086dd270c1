"""The conventional inversion with rate-dependent terms put in: the paper's indirect approach.

    y = Σ_i (k_i u̇ + b_i) H_ri[u]   is taken to be undone by   u = Σ_i w'_i(ẏ_d) H_r'i(ẏ_d)[y_d]

with r' and w' by the closed form at every sample, from weights k ẏ_d + b. So thresholds of the inverse move
with the rate as well. Ang, Khosla and Riviere, *Feedforward controller with inverse rate-dependent model for
piezoelectric actuators in trajectory-tracking applications*, IEEE/ASME Trans. Mechatronics 12(2), 2007; Tan,
Latt, Shee, Riviere and Ang, 2009; Qin et al. (2013), Section II-C and Fig. 8.

Not an inverse: the rate is that of the output where the model has that of the input, and plays whose
thresholds move change the output even where the weights would not. The error vanishes with the rate.
"""

from torchpi.control.indirect.base import IndirectInverse


class RateDependentInverse(IndirectInverse):
    """Krejčí–Kuhnen inversion of the weights k ẏ_d + b, `weight_slopes` and `weights`, at every sample.

    `rates_um_s` is where the model can be inverted: outside of it some w_0 + … + w_i comes down to a
    twentieth of its value at rest, and the rate is held at that end.
    """
