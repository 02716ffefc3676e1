"""The adaptive feed-forward in plain NumPy, straight from its description; learners are given."""

import numpy as np
from scipy.optimize import brentq
from scipy.signal import savgol_coeffs


def table_row(table, joint, position):
    """Commands at this position over `table.share`, linear between the table's positions."""
    rows = table.command[joint]
    place = np.clip((position - table.start[joint]) / table.spacing[joint], 0, len(rows) - 1)
    low = min(int(place), len(rows) - 2)
    return rows[low] + (place - low) * (rows[low + 1] - rows[low])


def on_row(x, row, share):
    """The row at this share, continued in straight lines beyond its first and last column."""
    if share < x[0]:
        return row[0] + (share - x[0]) * (row[1] - row[0]) / (x[1] - x[0])
    if share > x[-1]:
        return row[-1] + (share - x[-1]) * (row[-1] - row[-2]) / (x[-1] - x[-2])
    return np.interp(share, x, row)


def table_command(table, joint, position, share):
    """Bilinear table, continued in straight lines beyond the first and the last column."""
    return on_row(table.share, table_row(table, joint, position), share)


def table_share(table, joint, position, command):
    """The speed at which the table gives this command: its root."""
    if np.isnan(position):
        return np.nan
    x, row = table.share, table_row(table, joint, position)
    return brentq(lambda s: on_row(x, row, s) - command, -1e3, 1e3, xtol=1e-15)


class Feedforward:
    """The same constants as `leglab.control.feedforward.adaptive` hands to the core."""

    def __init__(self, parts, table, learner):
        self.p, self.table, self.learner = parts, table, learner
        self.joints = len(table.start)
        n, h = parts["kernel"].shape[1], parts["control_period"]
        self.kernel = [savgol_coeffs(n, 4, deriv=d, delta=h, use="dot") for d in range(4)]
        self.readings, self.rows = [], []  # rows: position, flow, command
        self.count = 0
        self.sent = self.last = np.zeros(self.joints)
        self.last_acceleration = None
        self.applied, self.withheld = np.zeros(self.joints), np.zeros(self.joints)
        self.squares = np.zeros((2, self.joints))
        self.fallback = np.zeros(self.joints, dtype=bool)

    def inputs(self, motion, flow=None):
        p, n = self.p, self.joints
        q = (motion[0] - p["centre"]) / p["half_range"]
        v = motion[1] / p["full_speed"]
        own = v if flow is None else flow
        a, j = motion[2] / p["acceleration"], motion[3] / p["jerk"]
        out = []
        for i in range(n):
            row = [own[i], j[i]] + ([own[i] * q[i]] if p["products"] else [])
            for k in np.roll(np.arange(n), -i):
                row += [a[k], q[k]] + ([v[k]] if k != i else [])
                if p["products"]:
                    row += [abs(own[i]) * a[k], abs(own[i]) * q[k]]
            out.append(row)
        return np.array(out), v

    def learn(self, time, position):
        p = self.p
        self.readings = [*self.readings[-2:], position]
        self.count += 1
        if len(self.readings) == 3:
            a, b, c = self.readings
            most = p["greatest_acceleration"] * p["control_period"] ** 2
            if not (np.abs(c - 2 * b + a) <= most).all():
                self.rows = []
        flow = [table_share(self.table, j, position[j], self.sent[j]) for j in range(self.joints)]
        self.rows = [*self.rows, (position, np.array(flow), self.sent)][-p["kernel"].shape[1] :]
        if self.count % p["interval"] or time >= p["stop_time"]:
            return
        if len(self.rows) < p["kernel"].shape[1]:
            return
        positions, flows, commands = (np.array(part) for part in zip(*self.rows, strict=True))
        motion = np.array([weights @ positions for weights in self.kernel])
        flow = self.kernel[0] @ flows
        inputs, v = self.inputs(motion, flow if p["forward"] else None)
        if not np.abs(v).max() >= p["least_speed"]:
            return
        usable = (
            (np.abs(commands).max(axis=0) < p["saturation"])
            & (motion[0] > p["learn_lower"])
            & (motion[0] < p["learn_upper"])
        )
        self.learner.update(inputs, np.where(usable, flow - v, np.nan))

    def step(self, time, position, reference):
        """The feed-forward, and the reference's position and velocity as the sensors show them."""
        p, h = self.p, self.p["control_period"]
        self.learn(time, position)
        r, rd, rdd = reference
        jerk = 0 * rdd if self.last_acceleration is None else (rdd - self.last_acceleration) / h
        self.last_acceleration = rdd

        def at(t):
            return (
                r + t * rd + t**2 / 2 * rdd + t**3 / 6 * jerk,
                rd + t * rdd + t**2 / 2 * jerk,
                rdd + t * jerk,
                jerk,
            )

        motion = np.array(at(p["lead"]))
        inputs, v = self.inputs(motion)
        excess = self.learner.predict(inputs)
        for _ in range(3 if p["forward"] else 0):
            excess = self.learner.predict(self.inputs(motion, v + excess)[0])
        seen = at(-p["position_delay"])[0]
        out = np.empty(self.joints)
        for j in range(self.joints):
            limit = p["limit"]
            learned = np.clip(
                table_command(self.table, j, motion[0, j], v[j] + excess[j]), -limit, limit
            )
            plain = np.clip(table_command(self.table, j, motion[0, j], v[j]), -limit, limit)
            if p["supervised"]:
                gained = table_share(self.table, j, motion[0, j], learned) - table_share(
                    self.table, j, motion[0, j], plain
                )
                self.supervise(j, position[j] - seen[j], gained)
            wish = plain if self.fallback[j] else learned
            if self.count > 1:
                most = p["rate_limit"] * h
                wish = np.clip(wish, self.last[j] - most, self.last[j] + most)
            out[j] = wish
        self.last = out
        return out, (seen, at(-p["velocity_delay"])[1])

    def supervise(self, j, error, gained):
        if not np.abs(error) < 1e3:
            return
        p, h = self.p, self.p["control_period"]
        decay = np.exp(-p["bandwidth"][j] * h)
        gain = (1 - decay) / p["bandwidth"][j] * p["full_speed"][j]
        both = np.array([error + self.withheld[j], error - self.applied[j]])
        used = 0.0 if self.fallback[j] else gained
        self.applied[j] = decay * self.applied[j] + gain * used
        self.withheld[j] = decay * self.withheld[j] + gain * (gained - used)
        self.squares[:, j] += min(1, h / p["trust_time"]) * (both**2 - self.squares[:, j])
        learned, plain = self.squares[:, j]
        if self.fallback[j]:
            self.fallback[j] = learned > plain / p["margin"] ** 2
        else:
            self.fallback[j] = learned > p["margin"] ** 2 * plain + p["noise"] ** 2
