"""Forward selection of features for models of lags, fitted to the free run."""

from collections.abc import Sequence

import numpy as np

from leglab.identification.structure.fit import (
    LEAST_SHARE,
    Array,
    Features,
    Fit,
    Further,
    Problem,
    Simulator,
    Stretch,
    fit,
    prior,
    solve,
)

_TRIED = 3  # number of candidate features that are fitted, by expected gain; the best is added
_GLANCE, _STEPS = 3, 10  # iterations of the fit of each candidate, and of the refit of the best
_WORTH = 0.997  # a feature is added if it multiplies the RMS error by at most this ratio


class LagPath:
    """Forward selection of features by the free-run error that each is expected to explain."""

    def __init__(
        self,
        problem: Problem,
        start: Fit,
        further: Further,
        stretches: list[Stretch],
        strength: float,
    ) -> None:
        self._problem, self._further, self._stretches = problem, further, stretches
        self._strength = strength
        self.fit, self.ended = start, False

    def grow(self) -> None:
        """Adds one feature; ends the selection if the RMS error falls too little (`_WORTH`)."""
        self.ended = self.ended or not self._further.features
        if self.ended:
            return
        gains = promises(self._problem, self.fit, self._further, self._stretches, self._strength)
        best: tuple[Fit, int] | None = None
        for k in np.argsort(-gains, kind="stable")[:_TRIED]:
            theta = np.append(self.fit.theta, np.zeros(self._further.blocks[k].count))
            features = (*self.fit.features, self._further.features[k])
            tried = self._fitted(features, theta, _GLANCE)
            if best is None or tried.error < best[0].error:
                best = tried, int(k)
        if best is not None:
            best = self._fitted(best[0].features, best[0].theta, _STEPS), best[1]
        if best is None or best[0].error > _WORTH * self.fit.error:
            self.ended = True
            return
        self.fit, taken = best
        self._further = self._further.without(taken)

    def _fitted(self, features: Features, theta: Array, iterations: int) -> Fit:
        lagged = self._problem.lagged(features).features
        return fit(self._problem, lagged, theta, self._stretches, self._strength, iterations)


def promises(
    problem: Problem,
    present: Fit,
    further: Further,
    stretches: Sequence[Stretch],
    strength: float,
) -> Array:
    """Estimates the share of the remaining squared error that each candidate feature explains.

    To first order the gain is b' G^-1 b with G = D'D - D'J (J'J)^-1 J'D and b = D'r -
    D'J (J'J)^-1 J'r: J and D are sensitivities of the model and of the feature, r the errors.
    """
    settings = problem.lagged(present.features)
    simulator = Simulator(settings, problem.records, further.blocks)
    sums = simulator.sums(present.theta, stretches, sensitivities=True)
    scale = max(sums.error, LEAST_SHARE)
    p = len(present.theta)
    share = strength / problem.count
    form = share * prior(settings.features, settings.blocks)
    hessian = sums.products[:p] / scale + form
    downhill = sums.gradient[:p] / scale - form @ present.theta
    cross = sums.products[p:] / scale
    inner = solve(hessian, np.column_stack([cross.T, downhill]))
    left = sums.gradient[p:] / scale - cross @ inner[:, -1]
    sizes = np.array([block.count for block in further.blocks])
    ends, corners = np.cumsum(sizes), np.cumsum(sizes * (sizes + 1) // 2)
    explained = np.einsum("ij,ji->i", cross, inner[:, :-1])  # diagonal of D'J (J'J)^-1 J'D
    gains = np.zeros(len(sizes))
    single = sizes == 1
    at = ends[single] - 1
    gram = sums.squares[corners[single] - 1] / scale + share - explained[at]
    # In exact arithmetic gram is at least the prior's `share`, but rounding can make it smaller.
    gains[single] = left[at] ** 2 / np.maximum(gram, share)
    for k in np.flatnonzero(~single):
        n = sizes[k]
        rows = slice(ends[k] - n, ends[k])
        block = np.zeros((n, n))
        block[np.tril_indices(n)] = sums.squares[corners[k] - n * (n + 1) // 2 : corners[k]] / scale
        block += np.tril(block, -1).T
        block += share * prior(further.features[k : k + 1], further.blocks[k : k + 1])
        block -= cross[rows] @ inner[:, :-1][:, rows]
        gains[k] = left[rows] @ solve(block, left[rows])
    return np.where(np.isfinite(gains), gains, 0.0)
