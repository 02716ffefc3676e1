"""Online identification: the paper's BSNN-ARX model and the identifier that is deployed."""

from leglab.identification.basis import Basis
from leglab.identification.bsnn_arx import Bsnn, BsnnArx, BsnnArxSettings
from leglab.identification.front import Identifier
from leglab.identification.settings import ChangeDetection, Guard, Rls

__all__ = [
    "Basis",
    "Bsnn",
    "BsnnArx",
    "BsnnArxSettings",
    "ChangeDetection",
    "Guard",
    "Identifier",
    "Rls",
]
