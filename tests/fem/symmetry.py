"""Planes of symmetry for tests of `fem`: half, quarter and eighth models, and plane strain."""

from __future__ import annotations

import numpy as np

import fem.preparation
import fem.strength as module


def hold_planes(monkeypatch, *planes) -> None:
    """Hold displacement component `axis` of the nodes on planes (axis, coordinate [m], ...).

    planes: pairs (axis, coordinate), or (axis, None) for every node (plane strain). They take the
    place of the guides that would otherwise remove the rigid motions.
    """
    original = module._Test._fixed_unknowns

    def fixed_unknowns(self):
        fixed, moved = original(self)
        coordinates = self.discretisation.mesh.coordinates
        size = np.ptp(coordinates, axis=0).max()
        for axis, value in planes:
            here = slice(None)
            if value is not None:
                here = abs(coordinates[:, axis] - value) < 1e-6 * size
            fixed[here, axis] = True
        return fixed, moved

    monkeypatch.setattr(fem.preparation, "guide_vertices", lambda *_: [])
    monkeypatch.setattr(module._Test, "_fixed_unknowns", fixed_unknowns)
