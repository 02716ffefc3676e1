"""Plain-NumPy reference of the deployed identifier, on the parts of `identification_oracle`.

Signals are scaled here as there: x' = (x - centre) / half range. Features are tuples:
("lags", signal, first, count), ("constant",), ("spline", signal, lag, Splines, factor) with
factor None or (signal, lag), and ("hammerstein", signal, first, count, Splines, mu). Signal 0
is the output.
"""

import numpy as np

from tests.reference.identification_oracle import REAL


class SplineNarx:
    def __init__(self, features, rls, scales, output_error_after=0, threshold=0.5):
        self.features, self.rls, self.scales = features, rls, scales
        self.after, self.threshold = output_error_after, REAL(threshold)
        self.depth = max(self._deepest(f) for f in features)
        self.u = [[REAL(0)] * (self.depth + 1) for _ in scales[1:]]
        self.y = [REAL(0)] * (self.depth + 1)  # y(t - k) at [k]
        self.w = []
        for feature in features:
            if feature[0] == "hammerstein":
                splines = feature[4]
                self.w.append(
                    np.array(
                        [sum(splines.t[i + 1 : i + 3]) / 2 for i in range(splines.count)],
                        dtype=REAL,
                    )
                )
        self.taken = self.learned = self.resynchronised = 0
        self.running = False

    @staticmethod
    def _deepest(feature):
        if feature[0] == "constant":
            return 1
        if feature[0] == "spline":
            return max(feature[2], feature[4][1] if feature[4] else 0)
        return feature[2] + feature[3] - 1

    def update(self, u, y):
        for past, x, (centre, half) in zip(self.u, np.atleast_1d(u), self.scales[1:], strict=True):
            past.insert(0, (REAL(x) - REAL(centre)) / REAL(half))
            past.pop()
        centre, half = (REAL(v) for v in self.scales[0])
        target = (REAL(y) - centre) / half
        phi = self._regressor(self.y)
        prediction = self.rls.theta @ phi
        self.taken += 1
        learns = self.taken > self.depth  # before, the regressor holds no samples yet
        self.learned += learns
        own = target
        if self.running:
            own = self._refine(target)
        if learns and not self.running:
            error = target - prediction
            slopes = self._weight_slopes()
            self.rls.update(phi, error)
            self._move(slopes, error)
        self.y = [REAL(0), target, *self.y[1:-1]]
        if self.running:
            self.simulated = [REAL(0), own, *self.simulated[1:-1]]
        elif self.after and self.learned >= self.after:
            self.running, self.simulated = True, list(self.y)
            width = len(phi) + sum(len(w) for w in self.w)
            self.psi = [np.zeros(width, dtype=REAL) for _ in range(self.depth + 1)]
        return centre + half * prediction

    def _refine(self, target):
        """Recursive prediction error step (Ljung and Soderstrom 1983)."""
        phi = self._regressor(self.simulated)
        simulated = self.rls.theta @ phi
        direct = np.concatenate([phi, *self._weight_slopes()])
        rise = self._output_slopes(self.simulated)
        psi = direct + sum(rise[k] * self.psi[k - 1] for k in range(1, self.depth + 1))
        self.psi = [psi, *self.psi[:-1]]
        error = target - simulated
        if abs(error) > self.threshold:
            self.resynchronised += 1
            self.running = False
            return target
        n = len(phi)
        self.rls.update(psi[:n], error)
        sizes = np.cumsum([len(w) for w in self.w])[:-1]
        self._move(np.split(psi[n:], sizes) if self.w else [], error)
        return simulated

    def _at(self, signal, lag, y):
        return y[lag] if signal == 0 else self.u[signal - 1][lag]

    def _regressor(self, y):
        phi, h = [], 0
        for feature in self.features:
            if feature[0] == "constant":
                phi.append(REAL(1))
            elif feature[0] == "lags":
                _, signal, first, count = feature
                phi += [self._at(signal, first + k, y) for k in range(count)]
            elif feature[0] == "spline":
                _, signal, lag, splines, factor = feature
                scale = self._at(*factor, y) if factor else REAL(1)
                phi += list(splines.values(self._at(signal, lag, y)) * scale)
            else:
                _, signal, first, count, splines, _ = feature
                for k in range(count):
                    phi.append(self.w[h] @ splines.values(self._at(signal, first + k, y)))
                h += 1
        return np.array(phi, dtype=REAL)

    def _thetas(self):
        at = 0
        for feature in self.features:
            kind = feature[0]
            size = 1 if kind == "constant" else feature[3].count if kind == "spline" else feature[3]
            yield feature, self.rls.theta[at : at + size]
            at += size

    def _output_slopes(self, y):
        """d y(t) / d y(t - k) at [k]."""
        rise = np.zeros(self.depth + 1, dtype=REAL)
        for feature, theta in self._thetas():
            if feature[0] == "lags" and feature[1] == 0:
                rise[feature[2] : feature[2] + feature[3]] += theta
            if feature[0] == "spline":
                _, signal, lag, splines, factor = feature
                x = self._at(signal, lag, y)
                if signal == 0:
                    scale = self._at(*factor, y) if factor else REAL(1)
                    rise[lag] += theta @ splines.slopes(x) * scale
                if factor and factor[0] == 0:
                    rise[factor[1]] += theta @ splines.values(x)
        return rise

    def _weight_slopes(self):
        """d y(t) / d w of each hammerstein feature."""
        slopes = []
        for feature, theta in self._thetas():
            if feature[0] == "hammerstein":
                _, signal, first, _, splines, _ = feature
                slopes.append(
                    sum(
                        b * splines.values(self.u[signal - 1][first + k])
                        for k, b in enumerate(theta)
                    )
                )
        return slopes

    def _move(self, slopes, error):
        constants = [f[5] for f in self.features if f[0] == "hammerstein"]
        for h, (slope, mu) in enumerate(zip(slopes, constants, strict=True)):
            self.w[h] = self.w[h] + REAL(mu) * error * slope / (REAL(0.01) + slope @ slope)
