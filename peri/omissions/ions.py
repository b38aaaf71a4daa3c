"""What a march of metal and ions does not compute of the liquid, and what that changes."""

from __future__ import annotations

from peri.coupled.degradation import Degradation
from peri.engine.omission import Omission


def ion_omissions(problem: Degradation) -> list[Omission]:
    """What of the liquid is not computed, and what that changes."""
    around, options = problem.surroundings, problem.options
    scene = problem.scene
    found = []
    if not problem.follows_minerals:
        found.append(
            Omission(
                "what a node holds when it turns liquid",
                "the rest of a dissolved metal node is not handed to the ions",
                scene.saturation_concentration / scene.solid_concentration,
                True,
                "what dissolves",
            )
        )
    found.append(
        Omission(
            "the liquid's own content",
            "it relaxes to rest while the release changes by this share"
            + (", or never, where nothing is refreshed" if problem.stores else ""),
            problem.storage_bound(),
            not problem.stores,
            "the release's change",
        )
    )
    if not problem.stores:
        content = max(abs(float(t)) for t in problem.medium.totals[:, 0])
        found.append(
            Omission(
                "the liquid that fills new pores",
                "the pore of a node that turned liquid takes what it holds from the medium at "
                "once, which a liquid at rest has no account of",
                content / scene.solid_concentration,
                True,
                "what dissolves",
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
    if options.closure == "none" and not problem.stores:
        bound = problem.potential_left_out
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
