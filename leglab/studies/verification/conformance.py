"""All cases of physics.md's table, each a function that yields rows."""

from collections.abc import Callable, Iterator, Mapping

from leglab.studies.verification import drift, dynamics, energy, friction, oil, steady
from leglab.studies.verification.rows import Row

CASES: Mapping[str, Callable[[], Iterator[Row]]] = {
    "a no-load speed": steady.no_load_speed,
    "b load": steady.loaded_speed,
    "c resonance": dynamics.resonance,
    "c damping": dynamics.damping,
    "d leak-down": dynamics.leak_down,
    "e drift": drift.open_drift,
    "e blocked ports": drift.blocked_drift,
    "e creep": drift.creep,
    "f viscosity": oil.viscosity,
    "f2 bulk modulus": oil.compressibility,
    "g friction": friction.stribeck,
    "g pre-sliding": friction.presliding,
    "h energy": energy.balance,
    "k worn stall": steady.worn_stall,
    "valve step": dynamics.spool_step,
    "null leak": steady.null_leak,
    "warming": energy.warming,
    "supply droop": energy.droop,
}
