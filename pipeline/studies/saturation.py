"""What the time step does to the volume loss under the two saturation models, as a table.

Mg-10Gd with Table 5.1 on the reference screw, 100 um, horizon 200 um, backward Euler: the liquid
reaches C_sat beside the metal from the first hours on.
"""

from peri.corrosion.run import corrode
from peri.engine.march.marching import TimeStepping
from pipeline.studies.cases import DAY, HOUR, screw_scene

STEPS = (48.0, 24.0, 12.0, 6.0, 3.0, 1.0)
END = 14 * DAY


def print_saturation(alloy: str = "Mg-10Gd", steps: tuple[float, ...] = STEPS) -> None:
    """Print V_L after 14 days for each model and step (h) as it stands in peri/MEASURED.md."""
    models = ("complementarity", "as_published")
    scenes = {model: screw_scene(alloy, 2, model) for model in models}
    print(f"\nVolume loss of {alloy} after 14 days in %, backward Euler with fixed steps.\n")
    print("| step [h] | complementarity | as published (Algorithm 1) |\n| ---: | ---: | ---: |")
    for step in steps:
        losses = [
            corrode(scenes[m], [END], TimeStepping("backward_euler", step * HOUR)).volume_loss[-1]
            for m in models
        ]
        print(f"| {step:g} | {100 * losses[0]:.3f} | {100 * losses[1]:.3f} |", flush=True)
