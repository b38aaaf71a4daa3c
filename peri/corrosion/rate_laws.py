"""Laws of the dissolution rate by name: the table that scenes and the command line read.

A new law is a class with `needs` and `rate` (peri.corrosion.kinetics.Kinetics) and a row here.
"""

from peri.corrosion.acidity import AcidityLaw
from peri.corrosion.kinetics import ButlerVolmer, ConstantRate, Kinetics, Tafel, VolumeLossLaw
from peri.corrosion.passivity import Repassivation, Rupture

KINETICS: dict[str, type[Kinetics]] = {
    "constant": ConstantRate,
    "volume_loss": VolumeLossLaw,
    "tafel": Tafel,
    "butler_volmer": ButlerVolmer,
    "acidity": AcidityLaw,
    "repassivation": Repassivation,
    "rupture": Rupture,
}
