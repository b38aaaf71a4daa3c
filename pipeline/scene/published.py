"""What the source says of its tensile test (Hermann 2024, 5.4), and what it leaves open.

The source prints no table, and its figures are not at hand: all that is known is its text.
"""

OUTCOME = (
    "By the text of the source (Hermann 2024, 5.4), whose tests pull the end faces, Mg-5Gd and "
    "Mg-10Gd are alike in the first weeks, Mg-5Gd then is a little ahead in spite of more volume "
    "loss, the order reverses later, and after 24 weeks Mg-5Gd keeps nearly nothing and Mg-10Gd "
    "about 20 %."
)
ALLOYS = ("Mg-5Gd", "Mg-10Gd")

KNOWN = (
    "the end faces are pulled",
    "to an elongation of 10 % of the length",
    "773,005 cells, whose edge is then about 47 µm",
    "the corrosion constants (Table 5.1)",
)

INFERRED = (
    "four-node cells, 50 µm thick at the end faces",
    "equilibrium, instead of an explicit march",
    "0.4 mm of liquid above the ends, from a number of nodes",
    "damage as the mean of each cell",
    "the hardening curves of both alloys",
)

UNDECIDED = (
    "horizon of the run on the 50 µm lattice",
    "liquid around the screw",
    "time step of the saturation model",
    "hardening curves of the two alloys",
    "whether faces or prongs were held, and laterally",
    "how the damage got to the mesh, and whether cells at its limit were deleted",
    "what ductility was measured by",
)
"""What the text does not say."""
