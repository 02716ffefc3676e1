"""Controllers, one a file, by name.

Importing this package makes all of them known to `leglab.control`; a new file here is found by
itself.
"""

from functools import partial

from leglab.control import CONTROLLERS
from leglab.registry import import_modules

CONTROLLERS.add_loader(partial(import_modules, __name__, __path__))
