"""A corroded screw for other programs: as arrays in Python, and as a deck of CalculiX.

Cost: half a minute of processor time; nothing more where three_lines.py has run in this folder.
The same without Python: perilife export RUN --to inp --time 8w
"""

from perilife import LifeCycle

result = LifeCycle("Mg-5Gd", "8w").run()
state = result.state("8w")
print(f"{len(state.cells)} tetrahedra, {state.dead.sum()} of them carry nothing")
for path in result.export("inp", "8w"):
    print(path)  # `ccx` with its name, less .inp, in that folder pulls it
