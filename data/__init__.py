"""Alloys, media and published parameter sets, each number with unit, source and kind.

In a checkout this folder is `data/`; it is imported as `perilife_data`.
"""
