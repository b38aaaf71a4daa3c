"""An alloy of one's own, my-alloy.toml with the sources in references.bib, held in two ways.

Cost: a minute of processor time.
"""

from pathlib import Path

from perilife import LifeCycle

alloy = Path(__file__).with_name("my-alloy.toml")
result = LifeCycle(alloy, "4w", hold=["shank", "slot"]).run()
print(result.table())
print(result.only(hold="slot").strength_left)
for key, reference in result.sources.items():
    print(f"{key}: {reference}")
