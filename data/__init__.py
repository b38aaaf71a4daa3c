"""Alloys, media and published parameter sets, each number with unit, source and kind.

In a checkout this folder is `data/`; it is imported as `perilife_data`.

>>> import perilife_data
>>> alloy = perilife_data.load_alloy("Mg-10Gd")
>>> alloy.young_modulus.si, alloy.young_modulus.source
(43000000000.0, 'hermann2024')
"""

from .electrodes import Electrode, common_reference, list_electrodes, load_electrode
from .experiments import Experiment, PublishedLoss, list_experiments, load_experiment
from .hardening import HardeningRecord, list_hardening, load_hardening
from .load import (
    list_alloys,
    list_media,
    list_parameter_sets,
    load_alloy,
    load_medium,
    load_parameter_set,
)
from .names import did_you_mean
from .reactions import ReactionSet, list_reaction_sets, load_reaction_set
from .references import Reference, load_reference
from .schema import (
    KINDS,
    TO_BE_LISTED,
    Alloy,
    CorrosionParameters,
    Medium,
    OwnCorrosion,
    ParameterSet,
    Quantity,
)
from .volume_loss import VolumeLossData, read_volume_loss_csv

__all__ = [
    "KINDS",
    "TO_BE_LISTED",
    "Alloy",
    "CorrosionParameters",
    "Electrode",
    "Experiment",
    "HardeningRecord",
    "Medium",
    "OwnCorrosion",
    "ParameterSet",
    "PublishedLoss",
    "Quantity",
    "ReactionSet",
    "Reference",
    "VolumeLossData",
    "common_reference",
    "did_you_mean",
    "list_alloys",
    "list_electrodes",
    "list_experiments",
    "list_hardening",
    "list_media",
    "list_parameter_sets",
    "list_reaction_sets",
    "load_alloy",
    "load_electrode",
    "load_experiment",
    "load_hardening",
    "load_medium",
    "load_parameter_set",
    "load_reaction_set",
    "load_reference",
    "read_volume_loss_csv",
]
