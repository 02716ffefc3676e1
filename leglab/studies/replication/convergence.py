"""The claims that weights settle within 300 samples and theta within 1500 (Sec. 4)."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from leglab.identification import BsnnArx
from leglab.studies.replication import paper
from leglab.studies.replication.online import Settings, linear_alone, static_alone

Array = NDArray[np.float64]

WEIGHTS_SETTLED = 300
"""Samples after which the paper calls the weights stable."""


@dataclass(frozen=True, kw_only=True)
class Convergence:
    """How far parameters have come when the paper calls them stable.

    Attributes:
        weights: Weights of the first BSNN instance over the training part, (n, neurons).
        bsnn: Its a-priori predictions, (n,).
        theta: ARX parameters of the first BSNN-ARX instance, (n, 6).
        theta_alone: Those of the first ARX instance, (n, 6).
        distances: Named measures, means over the instances.
    """

    weights: Array
    bsnn: Array
    theta: Array
    theta_alone: Array
    distances: dict[str, float]


def converge(u: Array, y: Array, instances: int, seed: int) -> Convergence:
    """Adapts on the experiment and carries the pass on to its end.

    Args:
        u: Input, longer than the training part, shape (n,).
        y: Output.
        instances: Instances of each model.
        seed: Of the initial parameters.
    """
    settings, n = Settings(), paper.N_TRAINING
    rng = np.random.default_rng(seed)
    model = BsnnArx(settings.bsnn_arx(), joints=instances)
    model.randomise(rng, settings.spread)
    start = np.atleast_2d(model.weights).copy()
    bsnn = static_alone(model.settings, model)
    alone = linear_alone(instances, rng, settings)
    order, neurons = model.settings.na + model.settings.nb, start.shape[-1]
    _, trajectory = _record(model, u, y)
    _, alone_trajectory = _record(alone, u, y)
    prediction, _ = _record(bsnn, u[:n], y[:n])
    theta, weights = trajectory[..., :order], trajectory[..., order : order + neurons]
    theta_alone = alone_trajectory[..., :order]

    basis = model.settings.network.basis[0]
    inside = np.clip(u[:n], basis.knots[0], basis.knots[-1])
    activation = np.array([np.mean(basis.spline(row)(inside)) for row in np.eye(neurons)])
    settled = weights[n - 1]
    to_go = np.sqrt(np.sum(activation * (weights[WEIGHTS_SETTLED - 1] - settled) ** 2, axis=-1))
    way = np.sqrt(np.sum(activation * (start - settled) ** 2, axis=-1))
    outside = np.mean((u[:n] < basis.knots[0]) | (u[:n] > basis.knots[-1]))
    distances = {
        "weights: part of the way from 0 to 1500 samples left at 300": float(np.mean(to_go / way)),
        f"theta of BSNN-ARX: distance at 1500 to its value at {len(u)}, relative": _away(theta, n),
        f"theta of ARX: distance at 1500 to its value at {len(u)}, relative": _away(theta_alone, n),
        "share of inputs outside [0, 0.8], clamped": float(outside),
    }
    return Convergence(
        weights=weights[:n, 0],
        bsnn=prediction[:, 0],
        theta=theta[:n, 0],
        theta_alone=theta_alone[:n, 0],
        distances=distances,
    )


def _record(model: BsnnArx, u: Array, y: Array) -> tuple[Array, Array]:
    """Predictions (n, J) and parameters (n, J, P) of all instances on the same signals."""
    if model.joints > 1:
        u, y = (np.broadcast_to(s[:, None], (len(s), model.joints)) for s in (u, y))
    prediction, trajectory = model.run_recorded(u, y)
    return prediction.reshape(len(u), -1), trajectory.reshape(len(u), model.joints, -1)


def _away(theta: Array, at: int) -> float:
    gone = np.linalg.norm(theta[at - 1] - theta[-1], axis=-1)
    return float(np.mean(gone / np.linalg.norm(theta[-1], axis=-1)))
