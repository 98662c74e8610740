"""Find a template that is partly hidden, in another light, far from where it was, or lost.

The tracker enters at `find_template`, which goes through `ATTEMPTS`.
"""

from microlib.tracking.robust._attempts import ATTEMPTS, find_template
from microlib.tracking.robust._decision import Candidate
from microlib.tracking.robust._search import Search, Sighting
from microlib.tracking.robust._template import make_search_template

__all__ = ["ATTEMPTS", "Candidate", "Search", "Sighting", "find_template", "make_search_template"]
