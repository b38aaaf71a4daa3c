"""Peridynamic corrosion of metals in liquids on uniform lattices (SI units throughout)."""
