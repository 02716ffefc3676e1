"""Front-end of all identifiers, from samples and arrays to predictions."""

import math
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from leglab.base.errors import RecordingError, SettingsError
from leglab.identification import checks

Array = NDArray[np.float64]


class Identifier:
    """Online identifier of one joint or of several of the same structure.

    Axes: N samples, J joints, M inputs; the axis of joints or inputs is left out if its length is
    one. So u of `run` has shape (N,), (N, M), (N, J) or (N, J, M); y has (N,) or (N, J).

    A sample is (u(t), y(t)); its prediction uses y up to t - 1 only. Bad samples (see `Guard`)
    are not learned; `diagnostics` counts them.
    """

    _banks: ClassVar[dict[str, Any]]
    settings: Any

    def __init__(self, settings: Any, *, joints: int = 1) -> None:
        self.settings = settings
        self.joints = joints
        if isinstance(joints, bool) or not isinstance(joints, int) or joints < 1:
            text = f"joints is {joints!r}: must be "
            raise SettingsError(text, given=joints, allowed="an integer of at least 1")
        self._bank = self._banks[settings.scalar](settings, joints)
        self.inputs = int(self._bank.inputs)
        self._single = joints == 1 and self.inputs == 1
        self._u_one = self._u_shape(())
        self._update = self._bank.update

    def update(self, u: Any, y: Any) -> Any:
        """Takes one sample, learns from it, and returns the a-priori prediction of y.

        Args:
            u: Input at this sample: a number, (M,), (J,) or (J, M).
            y: Output measured at this sample: a number or (J,). NaN (or None) marks a missing one.

        Returns:
            A number, or (J,) for several joints.

        Raises:
            LeglabError: A shape is wrong or a value is no number; nothing has been learned.
        """
        try:  # fast path: no copies or checks if types and shapes fit already
            if self._single:
                return self._update(u, y)
            if u.shape == self._u_one:
                if self.joints == 1:
                    return self._bank.update_row(u, y)
                if y.shape == (self.joints,):
                    prediction = np.empty(self.joints)
                    self._bank.update_many(u, y, prediction)
                    return prediction
        except (TypeError, AttributeError):
            pass
        u_array = _array("u", u, self._u_one)
        y_array = _array("y", y, (self.joints,) if self.joints > 1 else ())
        prediction = np.empty(self.joints)
        self._bank.update_many(u_array.reshape(-1), y_array.reshape(-1), prediction)
        return prediction if self.joints > 1 else float(prediction[0])

    def predict(self, u: Any) -> Any:
        """Predicts the next y for an input u; neither stores u nor changes the identifier.

        A model without lags can thus learn at one input and be evaluated at another: feed-forward
        learns at the measured motion and is evaluated at the reference.

        Args:
            u: As in `update`.

        Raises:
            LeglabError: The shape is wrong or a value is not finite.
        """
        # One dot product replaces a search: NaN and infinity propagate through it.
        prediction = np.empty(self.joints)
        if getattr(u, "shape", None) == self._u_one and u.dtype == np.float64:
            flat = u.ravel()  # a view where u is contiguous
        else:
            flat = _array("u", u, self._u_one).reshape(-1)
        if not math.isfinite(flat.dot(flat)):
            _require_finite("u", flat)
        self._bank.peek(flat, prediction)
        return prediction if self.joints > 1 else float(prediction[0])

    def run(self, u: ArrayLike, y: ArrayLike, *, missing: str = "raise") -> Array:
        """Learns from every sample of the arrays in turn; returns the a-priori predictions.

        Args:
            u: Inputs; see the class for the shape.
            y: Outputs, (N,) or (N, J).
            missing: Treatment of samples with NaN or infinity: "raise" before anything is
                learned, or "skip" them as `update` does.

        Returns:
            Predictions, the shape of y.

        Raises:
            LeglabError: Shapes do not fit, or a value is not finite.
        """
        u_array, y_array = self._arrays(u, y, missing)
        prediction = np.empty(y_array.shape)
        self._bank.run(u_array, y_array, prediction)
        return self._drop_joints(prediction)

    def run_recorded(
        self, u: ArrayLike, y: ArrayLike, *, missing: str = "raise"
    ) -> tuple[Array, Array]:
        """Runs `run`; also returns all parameters after each sample, (N, P) or (N, J, P)."""
        u_array, y_array = self._arrays(u, y, missing)
        prediction = np.empty(y_array.shape)
        trajectory = np.empty((*y_array.shape, self._bank.parameter_count))
        self._bank.run_recorded(u_array, y_array, prediction, trajectory)
        return self._drop_joints(prediction), self._drop_joints(trajectory)

    def freeze(self, frozen: bool = True) -> None:
        """Switches adaptation off (on with False); `update` then only predicts."""
        self._bank.freeze(frozen)

    @property
    def frozen(self) -> bool:
        """True if adaptation is switched off."""
        return bool(self._bank.frozen)

    def one_step(self, u: ArrayLike, y: ArrayLike, *, resume: bool = False) -> Array:
        """Predicts each y one step ahead with the current parameters; changes nothing.

        Args:
            u: Inputs; see the class for the shape.
            y: Measured outputs, (N,) or (N, J).
            resume: True if the arrays directly continue the identifier's last samples. If False,
                the first `lags` samples only fill the regressor: y is returned for them.

        Returns:
            Predictions, the shape of y.
        """
        u_array, y_array = self._arrays(u, y, "raise")
        given = 0 if resume else min(self.lags, len(y_array))
        prediction = np.empty(y_array.shape)
        self._bank.simulate(u_array, y_array, prediction, given, False)
        return self._drop_joints(prediction)

    def free_run(self, u: ArrayLike, y_initial: ArrayLike | None = None) -> Array:
        """Simulates y from the input alone with the current parameters; changes nothing.

        Args:
            u: Inputs; see the class for the shape.
            y_initial: The first outputs, (K,) or (K, J) with K >= lags, which are returned
                unchanged. None continues from the identifier's last samples.

        Returns:
            Outputs, (N,) or (N, J). They may overflow to infinity where the model is unstable.
        """
        u_array = _array("u", u, self._u_shape((None,)))
        u_array = u_array.reshape(len(u_array), self.joints, self.inputs)
        shape = (None, self.joints) if self.joints > 1 else (None,)
        initial = np.zeros((0, self.joints))
        if y_initial is not None:
            initial = _array("y_initial", y_initial, shape).reshape(-1, self.joints)
            if not self.lags <= len(initial) <= len(u_array):
                text = f"y_initial has {len(initial)} samples: must have "
                allowed = f"{self.lags} (the lags of the model) to {len(u_array)} (those of u)"
                raise RecordingError(text, given=len(initial), allowed=allowed)
            _require_finite("y_initial", initial)
        _require_finite("u", u_array)
        prediction = np.empty((len(u_array), self.joints))
        self._bank.simulate(u_array, initial, prediction, len(initial), True)
        return self._drop_joints(prediction)

    @property
    def lags(self) -> int:
        """Number of past samples that the regressor needs."""
        return int(self.settings.lags)

    @property
    def parameters(self) -> Array:
        """All parameters as one vector, (P,) or (J, P); assign to set them."""
        out: Array = self._bank.parameters()
        return out if self.joints > 1 else out[0]

    @parameters.setter
    def parameters(self, value: ArrayLike) -> None:
        shape: tuple[int, ...] = (self._bank.parameter_count,)
        shape = (self.joints, *shape) if self.joints > 1 else shape
        array = _array("parameters", value, shape)
        _require_finite("parameters", array)
        self._bank.set_parameters(array)

    def gain(self, joint: int = 0) -> Array:
        """Returns the gain matrix F of one joint, (n, n)."""
        return self._bank.gain(joint)

    def set_gain(self, value: ArrayLike, joint: int = 0) -> None:
        """Sets the gain matrix F of one joint.

        Args:
            value: Symmetric and positive definite, (n, n); only the upper triangle is read.
            joint: Index of the joint.

        Raises:
            LeglabError: The shape is wrong or a value is not finite.
        """
        array = _array("gain", value, self.gain(joint).shape)
        _require_finite("gain", array)
        self._bank.set_gain(joint, array)

    def hold_alarm(self, joint: int = 0) -> None:
        """Suppresses alarms of one joint's change detector for its hold-off, as after an alarm."""
        self._bank.hold_alarm(joint)

    def diagnostics(self, joint: int = 0) -> dict[str, float]:
        """Returns one joint's counts of samples by outcome, changes, forgetting and gain.

        In the output-error stage also `simulation_rms`: the RMS error of the model's simulation
        over about 500 samples in units of the output, each taken before the sample is learned.
        """
        return dict(self._bank.diagnostics(joint))

    def project_poles(self, radius: float = 0.999) -> bool:
        """Scales the poles of the linear part by one factor, if needed, to lie within the radius.

        Returns:
            Whether any joint's poles had to move.
        """
        checks.number("radius", radius, above=0.0, most=1.0)
        return bool(self._bank.project_poles(radius))

    def copy(self) -> Self:
        """Returns an independent identifier in the same state."""
        other = type(self)(self.settings, joints=self.joints)
        other._bank.set_state(self._bank.state())
        return other

    def _u_shape(self, head: tuple[int | None, ...]) -> tuple[int | None, ...]:
        joints = (self.joints,) if self.joints > 1 else ()
        return (*head, *joints, *((self.inputs,) if self.inputs > 1 else ()))

    def _arrays(self, u: ArrayLike, y: ArrayLike, missing: str) -> tuple[Array, Array]:
        if missing not in ("raise", "skip"):
            text = f"missing is {missing!r}: must be 'raise' or 'skip'"
            raise SettingsError(text, given=missing, allowed=("raise", "skip"))
        u_array = _array("u", u, self._u_shape((None,)))
        y_array = _array("y", y, (None, self.joints) if self.joints > 1 else (None,))
        if len(u_array) != len(y_array):
            text = f"u has {len(u_array)} samples and y {len(y_array)}: must agree"
            raise RecordingError(text, given=(len(u_array), len(y_array)))
        if missing == "raise":
            _require_finite("u", u_array)
            _require_finite("y", y_array)
        return (
            u_array.reshape(len(u_array), self.joints, self.inputs),
            y_array.reshape(-1, self.joints),
        )

    def _drop_joints(self, array: Array) -> Array:
        return array if self.joints > 1 else array[:, 0]


def _array(name: str, value: ArrayLike, shape: tuple[int | None, ...]) -> Array:
    try:
        array = np.ascontiguousarray(value, dtype=float)
    except (TypeError, ValueError):
        raise RecordingError(f"{name} is not ", given=name, allowed="an array of numbers") from None
    if array.ndim == 1 and shape == ():
        array = array.reshape(np.shape(value))
    fits = array.ndim == len(shape) and all(
        want is None or have == want for have, want in zip(array.shape, shape, strict=True)
    )
    if not fits and not (shape == () and array.size == 1):
        wanted = ", ".join("N" if want is None else str(want) for want in shape)
        text = f"{name} has shape {array.shape}: must be "
        raise RecordingError(text, given=array.shape, allowed=f"({wanted})")
    return array


def _require_finite(name: str, array: Array) -> None:
    bad = np.argwhere(~np.isfinite(array))
    if len(bad):
        value = float(array[tuple(bad[0])])
        raise RecordingError(
            f"{name} is {value} at index {bad[0][0]} ({len(bad)} values are not finite): must be "
            "finite; `run` can skip such samples",
            given=value,
            allowed="finite",
        )
