"""Constants and simulations of Qin et al. (2013), one per file; they return numbers and curves, no plots."""
