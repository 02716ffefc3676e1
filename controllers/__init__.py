"""Controllers, one a file, by name.

Importing this package makes all of them known to `leglab.control`; a new file here is found by
itself.
"""

from functools import partial

from leglab.base.registry import import_modules
from leglab.control.contract import CONTROLLERS, controller_names, make_controller

__all__ = ["controller_names", "make_controller"]

CONTROLLERS.add_loader(partial(import_modules, __name__, __path__))
