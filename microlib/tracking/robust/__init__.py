"""Find a template that is partly hidden, in another light, far from where it was, or lost.

The tracker enters at `find_template`, which goes through `ATTEMPTS`.
"""

from microlib.tracking.robust._attempts import ATTEMPTS, Found, Scene, Sighting, find_template
from microlib.tracking.robust._search import RobustSearch

__all__ = ["ATTEMPTS", "Found", "RobustSearch", "Scene", "Sighting", "find_template"]
