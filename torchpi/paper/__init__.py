"""The constants and the simulations of Qin et al. (2013), one a file; numbers and curves, nothing drawn."""
