"""What is left of a screw of Mg-5Gd after eight weeks: numbers, the report, a drawing.

Cost: half a minute of processor time. Asked again, the run is read from runs/.
"""

from perilife import LifeCycle

result = LifeCycle("Mg-5Gd", "8w").run()
print(result)
print(f"{100 * result.strength_left:.0f} % of the strength, {result.peak_force:.0f} N, are left")
result.plot().savefig("three_lines.png")
