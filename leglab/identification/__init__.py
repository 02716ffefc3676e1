"""Online identification: the paper's BSNN-ARX model and the identifier that is deployed."""

from leglab.identification.basis import Basis
from leglab.identification.bsnn_arx import Bsnn, BsnnArx, BsnnArxSettings
from leglab.identification.features import Constant, Hammerstein, Lags, Signal, Spline, Term
from leglab.identification.front import Identifier
from leglab.identification.settings import ChangeDetection, Guard, Rls
from leglab.identification.spline_narx import SplineNarx, SplineNarxSettings
from leglab.identification.spline_state_space import (
    SplineStateSpace,
    SplineStateSpaceSettings,
    StateSpace,
)
from leglab.identification.storage import load, restore, save

__all__ = [
    "Basis",
    "Bsnn",
    "BsnnArx",
    "BsnnArxSettings",
    "ChangeDetection",
    "Constant",
    "Guard",
    "Hammerstein",
    "Identifier",
    "Lags",
    "Rls",
    "Signal",
    "Spline",
    "SplineNarx",
    "SplineNarxSettings",
    "SplineStateSpace",
    "SplineStateSpaceSettings",
    "StateSpace",
    "Term",
    "load",
    "restore",
    "save",
]
