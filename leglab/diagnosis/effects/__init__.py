"""Effects that a simulation may lack, one family per file; the import registers all of them."""

from leglab.base.registry import import_modules
from leglab.diagnosis.effects.base import Effect, EffectParameter, all_effects, register_effect

__all__ = ["Effect", "EffectParameter", "all_effects", "register_effect"]

import_modules(__name__, __path__)
