"""Controllers, one per file, registered by name.

Importing this package registers all of them with `leglab.control`; a new file in this folder is
imported too.
"""

from functools import partial

from leglab.base.registry import import_modules
from leglab.control.contract import CONTROLLERS, controller_names, make_controller

__all__ = ["controller_names", "make_controller"]

CONTROLLERS.add_loader(partial(import_modules, __name__, __path__))
