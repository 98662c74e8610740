"""Membranes beyond the point-load model: discs and capsules at any depth, and walls that relax.

The public functions of this package are those of `microlib.membrane`.
"""
