"""The paper's model: B-spline network and ARX model learning together (Algorithm 1)."""

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from leglab._native import identification as native
from leglab.base.errors import SettingsError
from leglab.identification import checks, linear
from leglab.identification.basis import Basis
from leglab.identification.checks import a_number, a_whole
from leglab.identification.front import Array, Identifier
from leglab.identification.settings import Guard, Rls, Scalar

if TYPE_CHECKING:
    import control
    from scipy.interpolate import BSpline

MAX_NETWORK_INPUTS = 8  # as in the core (bsnn.h)


@dataclass(frozen=True, kw_only=True)
class Bsnn(checks.Settings):
    """B-spline network, Eqs. 10 to 15.

    Attributes:
        basis: One basis per input.
        learning_constant: eta of Eq. 12 for each input (eta_1j of Eq. 15).
        two_layers: Eq. 13, a second-layer weight for each input.
        output_learning_constant: eta_2 of Eq. 14.
        bias: Whether the output has a bias, learned by Eq. 12 with the first constant.
        saturation: Whether learning steps are multiplied by (1 - |w|).
    """

    owner: ClassVar = "bsnn"
    basis: tuple[Basis, ...]
    learning_constant: tuple[float, ...] = (0.14,)
    two_layers: bool = False
    output_learning_constant: float = a_number(0.0, least=0.0)
    bias: bool = True
    saturation: bool = True

    def __post_init__(self) -> None:
        inputs = len(self.basis)
        checks.whole("bsnn number of inputs", inputs, least=1, most=MAX_NETWORK_INPUTS)
        if len(self.learning_constant) == 1:
            object.__setattr__(self, "learning_constant", self.learning_constant * inputs)
        if len(self.learning_constant) != inputs:
            text = f"bsnn has {len(self.learning_constant)} learning constants: must be "
            raise SettingsError(text, given=self.learning_constant, allowed=str(inputs))
        for eta in self.learning_constant:
            checks.number("bsnn learning_constant", eta, least=0.0)
        super().__post_init__()

    @property
    def neurons(self) -> int:
        """Number of splines of all inputs."""
        return sum(basis.count for basis in self.basis)


@dataclass(frozen=True, kw_only=True)
class BsnnArxSettings(checks.Settings):
    """Structure and constants of a `BsnnArx`.

    Attributes:
        na: Past outputs in the regressor (n of Eq. 1).
        nb: Past network outputs in the regressor (m of Eq. 1).
        nk: Smallest lag of the network outputs [samples]; 1 in Eq. 3.
        network: The static part.
        rls: Recursive least squares of the linear part.
        guard: Which samples are refused.
        output_limit: Largest plausible |y| in units of y; 0 allows any.
        opening: Learning constants are multiplied by 1 + opening * g, where g starts at 1, fades,
            and returns to 1 on a detected change. 0 keeps them constant as the paper does.
        fading: Time constant of g [samples].
        scalar: Arithmetic of the core.
    """

    na: int = a_whole(3, least=0, most=1000)
    nb: int = a_whole(3, least=1, most=1000)
    nk: int = a_whole(1, least=0, most=1000)
    network: Bsnn
    rls: Rls = field(default_factory=Rls)
    guard: Guard = field(default_factory=Guard)
    output_limit: float = a_number(0.0, least=0.0)
    opening: float = a_number(0.0, least=0.0)
    fading: float = a_number(300.0, least=1.0)
    scalar: Scalar = "float64"

    def __post_init__(self) -> None:
        super().__post_init__()
        self.guard.check_inputs(len(self.network.basis))

    @property
    def lags(self) -> int:
        """Samples of history the regressor reaches back."""
        return max(self.na, self.nb + self.nk - 1)

    @classmethod
    def paper_mode(cls) -> "BsnnArxSettings":
        """Returns the settings adopted for the paper's experiment (docs: identification).

        Eight splines on 11 knots over [0, 0.8], the range of Sec. 3.1. F(0) = 5.6 I and
        eta = 0.14 are not published: they are fitted to Table 1 of the paper.
        """
        basis = Basis.uniform(0.0, 0.8, 8, kind="paper")
        return cls(network=Bsnn(basis=(basis,)), rls=Rls(initial_gain=5.6))


class BsnnArx(Identifier):
    """The paper's BSNN-ARX model, adapted online sample by sample (Algorithm 1)."""

    _banks: ClassVar = {"float64": native.BsnnArx64, "float32": native.BsnnArx32}
    settings: BsnnArxSettings

    def randomise(self, rng: Generator, spread: float = 0.25) -> None:
        """Draws all parameters uniformly from [-spread, spread], as Sec. 3.1 does."""
        self.parameters = rng.uniform(-spread, spread, self.parameters.shape)

    @property
    def theta(self) -> Array:
        """ARX parameters [a_1 ... a_na, b_1 ... b_nb], (..., na + nb)."""
        return self.parameters[..., : self.settings.na + self.settings.nb]

    @property
    def weights(self) -> Array:
        """First-layer weights of all inputs, concatenated, (..., neurons)."""
        start = self.settings.na + self.settings.nb
        return self.parameters[..., start : start + self.settings.network.neurons]

    @property
    def bias(self) -> Array:
        """Bias of the network, (...,); zero if the network has none."""
        at = self.settings.na + self.settings.nb + self.settings.network.neurons
        if not self.settings.network.bias:
            return np.zeros(self.parameters.shape[:-1])
        return self.parameters[..., at]

    def static_spline(self, joint: int = 0, *, network_input: int = 0) -> "BSpline":
        """Returns the static map from one network input to the ARX input as a SciPy spline.

        With several inputs the bias belongs to none of them and is left out.
        """
        network = self.settings.network
        start = sum(basis.count for basis in network.basis[:network_input])
        basis = network.basis[network_input]
        weights = np.atleast_2d(self.weights)[joint, start : start + basis.count]
        if network.two_layers:
            first = len(network.basis) - network_input
            weights = weights * np.atleast_2d(self.parameters)[joint, -first]
        bias = float(np.atleast_1d(self.bias)[joint]) if len(network.basis) == 1 else 0.0
        return basis.spline(weights, bias)

    def transfer_function(
        self, joint: int = 0, *, timestep: float | bool = True
    ) -> "control.TransferFunction":
        """Returns the ARX part (Eq. 1) from the network's output n to y; timestep in seconds."""
        theta = np.atleast_2d(self.theta)[joint]
        na, nk = self.settings.na, self.settings.nk
        return linear.transfer_function(
            -theta[:na], np.concatenate((np.zeros(nk), theta[na:])), timestep
        )

    def poles(self, joint: int = 0) -> NDArray[np.complex128]:
        """Returns the poles of the ARX part, complex, (na,)."""
        return linear.poles(-np.atleast_2d(self.theta)[joint, : self.settings.na])
