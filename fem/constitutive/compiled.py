"""How the kernels are compiled."""

from numba import njit

# Divisions by zero give inf or nan, which the callers look for, instead of a branch each;
# products and sums may be fused. Nothing here assumes that numbers are finite.
kernel = njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
