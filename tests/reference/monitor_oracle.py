"""Sums, fits and the watch of the fault monitor in plain NumPy, straight from their description."""

import math

import numpy as np

MARGIN, PEAK_WINDOWS, OUTLIER = 2.0, 2.5, 9.0


class Moments:
    """Sums over samples (n, joints, parameters + 3), of all joints."""

    def __init__(self, samples):
        x, y = samples[..., :-3], samples[..., -3]
        self.information = np.einsum("njp,njq->jpq", x, x)
        self.correlation = np.einsum("njp,nj->jp", x, y)
        self.power = np.sum(y**2, axis=0)
        self.count = samples[..., -1].sum(axis=0)

    def about(self, parameters):
        out = object.__new__(Moments)
        out.information, out.count = self.information, self.count
        product = np.einsum("jpq,jq->jp", self.information, parameters)
        out.correlation = self.correlation - product
        less = np.einsum("jp,jp->j", 2 * self.correlation - product, parameters)
        out.power = np.maximum(self.power - less, 0.0)
        return out


def weights(moments, normal, discrepancy):
    """Weight of every joint's squared errors, (joints,)."""
    return 1.0 / (normal + discrepancy**2 * moments.power / np.maximum(moments.count, 1.0))


def fit(curves, moments, weight):
    """Size, spread and cost of every curve, and the cost without any."""
    without = float(weight @ moments.power)
    found = []
    for curve in curves:
        best = None
        for k in range(len(curve.sizes) - 1):
            one, step = curve.shifts[k], curve.shifts[k + 1] - curve.shifts[k]
            image = np.einsum("jpq,jq->jp", moments.information, step)
            bend = max(float(weight @ np.sum(image * step, axis=1)), 1e-300)
            slope = weight @ np.sum(step * moments.correlation - image * one, axis=1)
            share = np.clip(slope / bend, 0.0, 1.0)
            left = moments.about(one + share * step)
            cost = float(weight @ left.power)
            width = curve.sizes[k + 1] - curve.sizes[k]
            if best is None or cost < best[2]:
                best = curve.sizes[k] + share * width, abs(width) / math.sqrt(bend), cost
        found.append(best)
    return (*np.array(found).T, without)


def chances(keys, cost, correlation, independent, noise=0.0):
    """Probability of every key: noise and structure, whichever is the weaker evidence."""
    best = np.array([cost[keys == key].min() for key in range(max(keys) + 1)])
    unlikely = (best - best.min()) / (2 * correlation)
    if independent > 0:
        noise = min(noise, best.min())
        beyond = best - noise + 0.2 * noise
        unlikely = np.minimum(unlikely, independent / 2 * np.log(beyond / beyond.min()))
    return np.exp(-unlikely) / np.sum(np.exp(-unlikely))


class Watch:
    """Cumulative sums of every joint, and of all together."""

    def __init__(self, joints, settings, wait):
        self.set, self.wait = settings, wait
        self.normal, self.seen = np.zeros((2, joints))
        self.sum, self.peak, self.top, self.since = np.zeros((4, joints + 1))

    def take(self, time, mean, used):
        s = self.set
        ratio = mean / np.maximum(self.normal, 1e-300)
        rise = ratio * (1 - 1 / s["error_ratio"]) - math.log(s["error_ratio"])
        step = used / (2 * s["correlation"]) * rise
        step, seen = np.append(step, step.sum()), np.append(self.seen, self.seen.min())
        limit = s["alarm"] + MARGIN * self.peak
        total = np.where(seen >= s["slow_window"], np.maximum(self.sum + step, 0.0), 0.0)
        duration = used.max() * s["sample_period"]
        self.since[(self.sum == 0.0) & (total > 0.0)] = time - duration
        self.sum = total
        self.top = np.maximum(self.top, total)
        ended = np.where(total == 0.0, self.top, 0.0)
        peak_time = PEAK_WINDOWS * s["slow_window"] * s["sample_period"]
        self.peak = np.maximum(np.exp(-duration / peak_time) * self.peak, ended)
        self.top[total == 0.0] = 0.0
        return (total > limit) & (seen >= self.wait)

    def learn(self, mean, used):
        window = self.set["slow_window"]
        self.seen += used
        weight = np.maximum(used / window, used / np.maximum(self.seen, 1.0))
        most = np.where(self.seen < window, mean, OUTLIER * self.normal)
        self.normal += weight * (np.minimum(mean, most) - self.normal)


class Monitor:
    """The same settings as `leglab.control.feedforward.fault_monitor` hands to the core."""

    def __init__(self, joints, settings, wait):
        self.joints, self.set = joints, settings
        self.blocks = []
        self.close(wait)

    def close(self, wait):
        self.open = False
        self.watch = Watch(self.joints, self.set, wait)

    def take(self, time, samples, parameters):
        self.blocks = [*self.blocks, (time, samples, parameters)][-self.set["blocks"] :]
        used = samples[..., -1].sum(axis=0)
        mean = np.sum(samples[..., -2] ** 2, axis=0) / np.maximum(used, 1.0)
        alarm = self.watch.take(time, mean, used)
        if self.open:
            self.samples = [*self.samples, *self.late([self.blocks[-1]])]
            return False
        if not alarm.any():
            self.watch.learn(mean, used)
            return False
        self.onset = self.find_onset(self.watch.since[alarm].min())
        before = [b for b in self.blocks if b[0] <= self.onset] or self.blocks[:1]
        self.before, self.base = np.concatenate([b[1][..., :-3] for b in before]), before[-1][2]
        self.samples, self.open = self.late(self.blocks), True
        return True

    def late(self, blocks):
        """Samples that are far enough behind the onset."""
        start, period = self.onset + self.set["passing"], self.set["sample_period"]
        return [
            row
            for time, samples, _ in blocks
            for age, row in zip(range(len(samples))[::-1], samples, strict=True)
            if time - period * age >= start
        ]

    def find_onset(self, since):
        """The most likely step of the error's variance."""
        blocks = [b for b in self.blocks if b[0] > since]
        normal = np.maximum(self.watch.normal, 1e-300)
        ratio = np.array([np.sum(b[1][..., -2] ** 2 / normal) for b in blocks])
        count = np.array([b[1][..., -1].sum() for b in blocks])
        best, onset = -math.inf, since
        for k, (time, samples, _) in enumerate(blocks):
            after = count[k:].sum()
            level = max(ratio[k:].sum() / max(after, 1.0), 1.0)
            likelihood = -(ratio[:k].sum() + after * (math.log(level) + 1.0))
            if likelihood > best:
                best, onset = likelihood, time - len(samples) * self.set["sample_period"]
        return onset

    def look(self):
        """Sums of the case about the base."""
        return Moments(np.array(self.samples)).about(self.base)
