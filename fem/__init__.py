"""Finite-strain damage plasticity and the tensile test.

The package needs NumPy and Numba for the material, PETSc and dolfinx for the solution; it knows
nothing of corrosion or of geometry. Give it a tetrahedral mesh, a damage field at the quadrature
points and a material, and it returns the force-elongation curve:

>>> from fem.strength import TensileSettings, tensile_test
"""
