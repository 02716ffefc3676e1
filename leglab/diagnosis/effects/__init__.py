"""Effects that a simulation may lack, one family a file; importing the package registers all."""

from leglab.diagnosis.effects.base import Effect, EffectParameter, all_effects, register
from leglab.registry import import_modules

__all__ = ["Effect", "EffectParameter", "all_effects", "register"]

import_modules(__name__, __path__)
