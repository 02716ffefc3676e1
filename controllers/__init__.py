"""Controllers, one per file, registered by name.

This package makes `leglab.control` import every module in the folder before it looks up a name, so
that the module registers its controller; a new file needs no further entry.
"""

from functools import partial

from leglab.base.registry import import_modules
from leglab.control.contract import CONTROLLERS, controller_names, make_controller

__all__ = ["controller_names", "make_controller"]

CONTROLLERS.add_loader(partial(import_modules, __name__, __path__))
