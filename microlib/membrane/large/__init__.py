"""Membranes beyond the point-load model: discs and capsules at any depth.

The public functions of this package are those of `microlib.membrane`.
"""
