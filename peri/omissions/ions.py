"""What a march of metal and ions does not compute of the liquid, and what that changes."""

from __future__ import annotations

from scipy.ndimage import distance_transform_edt

from peri.coupled.degradation import Degradation
from peri.engine.omission import Omission


def ion_omissions(problem: Degradation) -> list[Omission]:
    """What of the liquid is not computed, and what that changes."""
    around, options = problem.surroundings, problem.options
    scene, first = problem.scene, problem.first
    found = []
    share = scene.saturation_concentration / scene.solid_concentration
    found.append(
        Omission(
            "what a node holds when it turns liquid",
            "the rest of a dissolved metal node is not handed to the ions",
            share,
            True,
            "what dissolves",
        )
    )
    width = float(
        distance_transform_edt(~scene.metal, sampling=scene.lattice.spacing)[scene.domain].max()
    )
    slowest = float(problem.medium.chemistry.diffusivity.min())
    relaxation = width**2 / (2 * slowest)
    found.append(
        Omission(
            "the liquid's own content",
            f"it relaxes within {relaxation:.0f} s, so it follows the release at rest; the bound "
            "is of its content for a release that halves in a day",
            relaxation / 86400.0,
            True,
            "the release's change",
        )
    )
    if not problem.follows_minerals:
        names = ", ".join(m.name for m in around.liquid.minerals) or "none is declared"
        found.append(
            Omission(
                "minerals",
                "none passes its nucleation index at the first release, which is the largest "
                f"({names}); the liquid is computed at the output times only",
                0.0,
                True,
                "the minerals",
            )
        )
    if options.closure == "none":
        bound = around.liquid.potential_bound(first)
        ion = problem.medium.chemistry.names[around.liquid.inert]
        found.append(
            Omission(
                "the potential",
                f"it stays below {1e3 * bound:.2g} mV; {ion} "
                "takes up the charge that diffusion separates",
                3.0 * bound / around.liquid.thermal_voltage,
                True,
                "a trivalent ion's amount",
            )
        )
    return found
