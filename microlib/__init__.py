"""Computer vision and mechanics for microstructures seen through an optical microscope.

Import the module you need, for example ``from microlib.membrane import elastic_modulus``. One unit
system throughout: µm, µN, s, so that moduli are in MPa; pixel quantities say so.
"""
