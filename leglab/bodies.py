"""Loads carried by the bodies of a model, which a scenario may change while it runs."""

import mujoco

from leglab.errors import unknown_name
from leglab.parameters import Parameter

ADDED_MASS = Parameter(
    name="added_mass",
    unit="kg",
    nominal=0.0,
    minimum=0.0,
    maximum=1000.0,
    minimum_allowed=True,
    description="point mass fixed at the body's centre of mass",
    offset=0,
)


class Bodies:
    """Point masses at the centres of mass of the moving bodies of a model.

    There they change neither the centre of mass nor the inertia about it, so that the body's frame
    of principal axes stays as it was compiled. The model itself changes: `restore` gives it back.

    Args:
        model: The model to change; nobody else may use it meanwhile.

    Attributes:
        elements: Names of the bodies that move.
    """

    def __init__(self, model: mujoco.MjModel) -> None:
        self._model = model
        self._ids = {
            model.body(i).name: i
            for i in range(1, model.nbody)
            if model.body_weldid[i] != 0 and model.body(i).name
        }
        self._nominal = model.body_mass.copy()
        self._added = dict.fromkeys(self._ids, 0.0)
        self._scratch: mujoco.MjData | None = None
        self.elements = tuple(self._ids)

    def has(self, element: str, name: str) -> bool:
        """Says whether a body has a parameter of this name."""
        return element in self._ids and name == ADDED_MASS.name

    def parameter(self, element: str, name: str) -> float:
        """Mass that a body carries [kg]."""
        self._check(element, name)
        return self._added[element]

    def set_parameter(self, element: str, name: str, value: float) -> None:
        """Loads a body from now on.

        Raises:
            LeglabError: If body or name do not exist or the mass [kg] is out of bounds.
        """
        self._check(element, name)
        value = ADDED_MASS.check(value, f"body {element!r}")
        if value == self._added[element]:
            return
        self._added[element] = value
        body = self._ids[element]
        self._model.body_mass[body] = self._nominal[body] + value
        # Inverse weights, subtree masses and the like follow from the masses (MuJoCo, "Modeling",
        # "Changing inertial properties"). On data of its own: mj_setConst overwrites the state.
        if self._scratch is None:
            self._scratch = mujoco.MjData(self._model)
        mujoco.mj_setConst(self._model, self._scratch)

    def restore(self) -> None:
        """Takes all loads off."""
        for element in self.elements:
            self.set_parameter(element, ADDED_MASS.name, 0.0)

    def _check(self, element: str, name: str) -> None:
        if element not in self._ids:
            raise unknown_name("body", element, self._ids)
        if name != ADDED_MASS.name:
            raise unknown_name("body parameter", name, [ADDED_MASS.name])
