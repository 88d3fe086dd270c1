"""The conventional inversion with rate-dependent terms inserted: the paper's indirect approach.

    y = Σ_i (k_i u̇ + b_i) H_ri[u]   is taken to be undone by   u = Σ_i w'_i(ẏ_d) H_r'i(ẏ_d)[y_d]

with r' and w' by the closed form at every sample, from weights k ẏ_d + b. The inverse's thresholds
thus vary with the rate. Ang, Khosla and Riviere, *Feedforward controller with inverse rate-dependent model
for piezoelectric actuators in trajectory-tracking applications*, IEEE/ASME Trans. Mechatronics 12(2), 2007;
Tan, Latt, Shee, Riviere and Ang, 2009; Qin et al. (2013), Section II-C and Fig. 8.

It is not an exact inverse: it uses the rate of the output where the model has that of the input, and plays
with moving thresholds change the output even where the weights would not. The error vanishes with the rate.
"""

from torchpi.control.indirect.base import IndirectInverse


class RateDependentInverse(IndirectInverse):
    """Krejčí–Kuhnen inversion of the weights k ẏ_d + b, `weight_slopes` and `weights`, at every sample.

    `rates_um_s` is the range in which the model can be inverted: at its ends some w_0 + … + w_i is down to a
    twentieth of its value at rest, and rates beyond are held at that end.
    """
