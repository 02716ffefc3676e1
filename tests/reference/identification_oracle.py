"""Plain-NumPy reference of the identification core, written from the equations.

Nothing here is shared with the C++ core: splines are evaluated one by one over all neurons, the
gain is a full matrix, and everything is computed in extended precision, so that what
differs is the rounding of the core. Equation numbers are those of Folgheraiter's paper.
"""

from bisect import bisect_right

import numpy as np

from leglab.identification import ChangeDetection

REAL = np.longdouble


class Splines:
    """Quadratic B-splines by Eq. 9, generalised to unequal knots."""

    def __init__(self, knots, kind="full", outside="clamp", middle="corrected"):
        k = np.asarray(knots, dtype=REAL)
        a, b = k[1] - k[0], k[-1] - k[-2]
        ends = [k[0] - 2 * a, k[0] - a], [k[-1] + b, k[-1] + 2 * b]
        self.t = [*ends[0], *k, *ends[1]]
        self.k, self.kind, self.outside, self.middle = list(k), kind, outside, middle
        self.count = len(k) + 1 if kind == "full" else len(k) - 3

    def values(self, u):
        """All splines at u, (count,)."""
        u = REAL(u)
        inside = min(max(u, self.k[0]), self.k[-1])
        value = self._all(u if self.outside == "quadratic" else inside, inside, False)
        if self.outside == "linear" and u != inside:
            value += (u - inside) * self._all(inside, inside, True)
        return self._kept(value)

    def slopes(self, u):
        """Derivatives of all splines at u, (count,)."""
        u = REAL(u)
        inside = min(max(u, self.k[0]), self.k[-1])
        if self.outside == "clamp" and u != inside:
            return np.zeros(self.count, dtype=REAL)
        return self._kept(self._all(u if self.outside == "quadratic" else inside, inside, True))

    def _kept(self, value):
        return value[2:-2] if self.kind == "paper" else value

    def _all(self, at, inside, derivative):
        # The interval of the clamped input says which polynomial piece holds; the last interval
        # includes its right end.
        interval = min(bisect_right(self.k, inside) - 1, len(self.k) - 2) + 2
        value = np.zeros(len(self.k) + 1, dtype=REAL)
        for i in range(interval - 2, interval + 1):  # all others are "0 otherwise"
            value[i] = self._piece(i, interval, at, derivative)
        return value

    def _piece(self, i, interval, u, derivative):
        a, b, c, d = self.t[i : i + 4]
        if interval == i:
            scale = (c - a) * (b - a)
            return 2 * (u - a) / scale if derivative else (u - a) ** 2 / scale
        if interval == i + 2:
            scale = (d - b) * (d - c)
            return -2 * (d - u) / scale if derivative else (d - u) ** 2 / scale
        # (u - k_i + dk) as printed, (u - k_i - dk) as corrected.
        start = a - (b - a) if self.middle == "printed" else b
        p, q = (c - a) * (c - b), (d - b) * (c - b)
        if derivative:
            return (a + c - 2 * u) / p + (d + start - 2 * u) / q
        return (u - a) * (c - u) / p + (d - u) * (u - start) / q


class ChangeDetector:
    """Quick against slow mean of the squared error; without settings it tells of no change."""

    def __init__(self, settings):
        self.settings, self.enabled = settings or ChangeDetection(), settings is not None
        self.fast = self.slow = REAL(0)
        self.samples = self.last = self.changes = 0

    def observe(self, squared):
        self.samples += 1
        windows = self.settings.fast_window, self.settings.slow_window
        weights = [max(REAL(1) / w, REAL(1) / self.samples) for w in windows]
        self.fast += weights[0] * (squared - self.fast)
        change = (
            self.enabled
            and self.samples > self.settings.hold_off
            and self.samples - self.last > self.settings.hold_off
            and self.fast > self.settings.ratio * self.slow
        )
        if change:
            self.last = self.samples
            self.changes += 1
        self.slow += weights[1] * (squared - self.slow)
        return change


class Rls:
    """Eqs. 5 to 8 with forgetting, on the full gain matrix."""

    def __init__(self, n, settings):
        self.settings, self.updates = settings, 0
        self.forgotten, self.restored = REAL(0), np.zeros(n, dtype=REAL)
        self.theta = np.zeros(n, dtype=REAL)
        self.gain = REAL(settings.initial_gain) * np.eye(n, dtype=REAL)
        self.factor = REAL(settings.forgetting_factor)
        self.detector = ChangeDetector(settings.change)

    def update(self, phi, error):
        phi = np.asarray(phi, dtype=REAL)
        changed = self.detector.observe(error * error)
        if changed:
            identity = np.eye(len(phi), dtype=REAL)
            change = self.settings.change
            kept = 0 if change.action == "reset" else self.gain
            self.gain = kept + REAL(change.gain) * identity
            self._limit()
        spread = self.gain @ phi
        power = phi @ spread
        if self.settings.forgetting == "directional":
            self.theta += spread * error / (1 + power)
            if power > 1e-12:
                beta = self.factor - (1 - self.factor) / power
                self.gain -= beta * np.outer(spread, spread) / (1 + beta * power)
                if beta < 0:
                    self._limit()
        else:
            known = {"none": REAL(1), "exponential": self.factor}
            factor = known.get(self.settings.forgetting)
            if factor is None:
                noise = self.settings.noise_variance or self.detector.slow
                information = (1 + power) * self.settings.memory * noise
                factor = 1 - error * error / information if information > 0 else REAL(1)
                factor = max(factor, self.factor)
            self.theta += spread * error / (factor + power)
            self.gain = (self.gain - np.outer(spread, spread) / (factor + power)) / factor
            if factor < 1:
                self._limit()
            self.forgotten += 1 - factor
        self.gain = (self.gain + self.gain.T) / 2
        self.updates += 1
        interval = self.settings.restore_interval
        if interval and self.updates % interval == 0:
            self._restore(self.updates // interval % len(self.theta) - 1)
        return changed

    def _restore(self, i):
        """Observes theta_i = 0 with the prior's variance, weighted by what was forgotten."""
        lost, self.restored[i] = self.forgotten - self.restored[i], self.forgotten
        if lost > 0:
            spread = self.gain[:, i]
            power = spread[i] + REAL(self.settings.restore_gain) / lost
            self.theta = self.theta - spread * self.theta[i] / power
            self.gain = self.gain - np.outer(spread, spread) / power

    def _limit(self):
        """Columns sqrt(d_j) u_j of F = U D U^T are kept within the bound, one by one."""
        bound = self.settings.gain_bound
        if np.trace(self.gain) <= bound:  # then no column can exceed it
            return
        left, columns = self.gain.copy(), []
        for j in reversed(range(len(left))):
            column = left[:, j] / left[j, j]
            column[j + 1 :] = 0
            columns.append((left[j, j], column))
            left = left - left[j, j] * np.outer(column, column)
        self.gain = sum(min(d, bound / (c @ c)) * np.outer(c, c) for d, c in columns)


class Bsnn:
    """Eqs. 9 to 15; one output."""

    def __init__(self, bases, eta, eta2=0.0, two_layers=False, bias=True, saturation=True):
        self.bases, self.eta, self.eta2 = bases, [REAL(e) for e in eta], REAL(eta2)
        self.two_layers, self.has_bias, self.saturation = two_layers, bias, saturation
        self.w1 = [np.zeros(basis.count, dtype=REAL) for basis in bases]
        self.w2 = np.ones(len(bases), dtype=REAL)
        self.b = REAL(0)
        self.violations = 0
        self.largest = REAL(0)

    def output(self, u):
        self.n = [b.values(x) for x, b in zip(np.atleast_1d(u), self.bases, strict=True)]
        self.branch = np.array([w @ n for w, n in zip(self.w1, self.n, strict=True)], dtype=REAL)
        return self.w2 @ self.branch + (self.b if self.has_bias else 0)

    def _step(self, w, n, eta, error):
        room = 1 - abs(w) if self.saturation else np.ones_like(w)
        step = eta * n * error
        if self.saturation:
            step = np.clip(step, -1023 / 1024, 1023 / 1024)
        return step * room, np.sum(eta * n * n * room)

    def adapt(self, error):
        contraction = REAL(0)
        back = self.w2.copy()
        if self.two_layers:
            step, part = self._step(self.w2, self.branch, self.eta2, error)
            self.w2, contraction = self.w2 + step, contraction + part
        for j, n in enumerate(self.n):
            step, part = self._step(self.w1[j], n, self.eta[j], back[j] * error)
            self.w1[j] = self.w1[j] + step
            contraction += back[j] ** 2 * part
        if self.has_bias:
            step, part = self._step(np.array([self.b]), np.ones(1, REAL), self.eta[0], error)
            self.b, contraction = self.b + step[0], contraction + part
        self.violations += not contraction < 2  # Eq. 21
        self.largest = max(self.largest, contraction)


class BsnnArx:
    """Algorithm 1."""

    def __init__(self, network, rls, na=3, nb=3, nk=1, opening=0.0, fading=300.0):
        self.network, self.rls, self.na, self.nb, self.nk = network, rls, na, nb, nk
        self.y = [REAL(0)] * na
        self.n = [REAL(0)] * (nb + nk)
        self.opening, self.fading, self.open = opening, fading, REAL(1)
        self.eta = [list(network.eta), network.eta2]

    def update(self, u, y):
        n = self.network.output(u)
        self.n = [n, *self.n[:-1]]
        phi = np.array([-x for x in self.y] + self.n[self.nk : self.nk + self.nb], dtype=REAL)
        prediction = self.rls.theta @ phi
        changed = self.rls.update(phi, y - prediction)
        if self.opening:
            self.open = REAL(1) if changed else self.open * (1 - 1 / REAL(self.fading))
            factor = 1 + self.opening * self.open
            self.network.eta = [factor * e for e in self.eta[0]]
            self.network.eta2 = factor * self.eta[1]
        self.network.adapt(y - n)
        self.y = [REAL(y), *self.y][: self.na]
        return prediction
