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


class Proof:
    """Which share of what was learned lately is used, joint by joint."""

    def __init__(self, parts, learner):
        self.p, self.learner, self.other = parts, learner, learner.copy()
        self.joints = self.other.joints
        self.slow = np.zeros_like(np.atleast_2d(learner.parameters))
        self.snapshots = [[0 * self.slow[j]] * 2 for j in range(self.joints)]
        self.said = {}
        self.means = np.zeros((3, self.joints))
        self.share = np.ones(self.joints)
        self.taken = np.zeros(self.joints, dtype=int)
        self.sample = parts["interval"] * parts["control_period"]

    def predict(self, parameters, inputs):
        self.other.parameters = np.reshape(parameters, self.other.parameters.shape)
        return self.other.predict(inputs)

    def used(self, count, inputs):
        learned = self.learner.predict(inputs)
        if self.p["settle_time"] == 0:
            return learned
        slow = self.predict(self.slow, inputs)
        beyond = self.predict([old for old, _ in self.snapshots], inputs)
        self.said[count] = slow, beyond
        return slow + self.share * (learned - slow)

    def take(self, count, found, learned):
        """Flows found (joints,), and which joints learned from them."""
        if self.p["settle_time"] == 0:
            return
        p, theta = self.p, np.atleast_2d(self.learner.parameters)
        asked = count - p["kernel"].shape[1] // 2 - 1
        nothing = np.zeros(self.joints), np.zeros(self.joints)
        slow, beyond = self.said.get(asked, nothing)
        for j in np.flatnonzero(learned):
            error = found[j] - slow[j]
            seen = np.array([error * beyond[j], beyond[j] ** 2, error**2])
            self.means[:, j] += min(1, self.sample / p["proof_time"]) * (seen - self.means[:, j])
            agreed, power, missed = self.means[:, j]
            prior = p["proof_noise"] ** 2 + p["proof_doubt"] * missed
            self.share[j] = np.clip((agreed + prior) / (power + prior), 0, 1)
            settle = min(1, self.sample / p["settle_time"])
            self.slow[j] = (1 - settle) * self.slow[j] + settle * theta[j]
            self.taken[j] += 1
            if self.taken[j] % max(1, round(p["proof_horizon"] / self.sample)) == 0:
                self.snapshots[j] = [self.snapshots[j][1], theta[j] - self.slow[j]]


class Feedforward:
    """The same constants as `leglab.control.feedforward.adaptive` hands to the core."""

    def __init__(self, parts, table, learner):
        self.p, self.table, self.learner = parts, table, learner
        self.proof = Proof(parts, learner)
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
        self.kept, self.parameters = [], []  # of every sample, before it is learned
        self.measured = ()  # what else is smoothed: pressures of both chambers [Pa], (joints,) each

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
        row = (position, np.array(self.flow(position)), self.sent, *self.measured)
        self.rows = [*self.rows, row][-p["kernel"].shape[1] :]
        if self.count % p["interval"] or time >= p["stop_time"]:
            return
        if len(self.rows) < p["kernel"].shape[1]:
            return
        positions, flows, commands, *more = (np.array(x) for x in zip(*self.rows, strict=True))
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
        middle = [self.kernel[0] @ part for part in (commands, *more)]
        self.update(inputs, motion, flow - v, usable, middle)

    def flow(self, position):
        """Shares of full speed that the last commands give at these positions."""
        return [table_share(self.table, j, position[j], self.sent[j]) for j in range(self.joints)]

    def update(self, inputs, motion, excess, usable, middle):
        self.learn_excess(inputs, excess, usable)

    def learn_excess(self, inputs, excess, usable):
        self.kept.append(np.array([excess, self.learner.predict(inputs), usable]))
        self.parameters.append(np.atleast_2d(self.learner.parameters).copy())
        counts = [self.learner.diagnostics(j)["learned"] for j in range(self.joints)]
        self.learner.update(inputs, np.where(usable, excess, np.nan))
        now = [self.learner.diagnostics(j)["learned"] for j in range(self.joints)]
        self.proof.take(self.count, excess, np.array(now) > counts)

    def command(self, wanted):
        """What to send (joints,) for these commands."""
        return wanted

    def wanted(self, motion, inputs, v):
        """Commands for the flow that the learned map asks for."""
        excess = self.proof.used(self.count, inputs)
        for _ in range(3 if self.p["forward"] else 0):
            excess = self.proof.used(self.count, self.inputs(motion, v + excess)[0])
        return [
            table_command(self.table, j, motion[0, j], v[j] + excess[j]) for j in range(self.joints)
        ]

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
        wanted = self.wanted(motion, inputs, v)
        seen = at(-p["position_delay"])[0]
        out = np.empty(self.joints)
        for j in range(self.joints):
            limit = p["limit"]
            learned = np.clip(wanted[j], -limit, limit)
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


class WornFeedforward(Feedforward):
    """With valves in a state (joints, 5); `slopes` learns what more of it does."""

    def __init__(self, parts, table, learner, slopes, shape):
        super().__init__(parts, table, learner)
        self.slopes, self.shape = slopes, np.array(shape, dtype=float)
        size = np.linalg.norm(self.shape, axis=1)
        self.along = self.shape / size[:, None]
        self.prior = (parts["state_noise"] / parts["state_doubt"] / size) ** 2
        self.spools, self.travel = np.zeros((2, self.joints)), np.zeros((2, self.joints))
        self.power, self.moved = np.zeros(self.joints), np.zeros(self.joints)
        self.turned, self.way = np.zeros(self.joints), np.zeros(self.joints)

    def limited(self, shape, j):
        widest = np.ptp(self.travel[:, j]) / 4
        lower, upper = [-0.5, -widest, 0, -0.5, -0.5], [0.5, widest, widest, 1, 1]
        return np.clip(shape, lower, upper)

    def to_valve(self, shape, wanted):
        """Command by which a valve of this state, without its play, does what is wanted of it."""
        shift, band, _, positive, negative = shape
        knee = max(2 * self.p["turn"], -4 * band)
        side = np.where(wanted > 0, positive, negative)
        return shift + wanted * (1 + side) + band * np.clip(wanted / knee, -1, 1)

    def flow(self, position):
        forget = 0.1 * self.p["control_period"] / self.p["state_time"] * np.ptp(self.travel, axis=0)
        low, high = self.travel
        self.travel = np.array(
            [np.minimum(self.sent, low + forget), np.maximum(self.sent, high - forget)]
        )
        flows = np.empty((2, self.joints))
        for k, more in enumerate((0.0, self.p["state_step"])):
            for j in range(self.joints):
                shape = self.limited(self.shape[j] + more * self.along[j], j)
                ends = self.sent[j] + np.array([-0.5, 0.5]) * shape[2]
                spool = self.spools[k, j] = np.clip(self.spools[k, j], *ends)
                wanted = brentq(
                    lambda x, s=shape, y=spool: self.to_valve(s, x) - y, -9, 9, xtol=1e-15
                )
                flows[k, j] = table_share(self.table, j, position[j], wanted)
        self.measured = (flows[1],)
        return flows[0]

    def update(self, inputs, motion, excess, usable, middle):
        error = excess - self.learner.predict(inputs)
        slope = (middle[1] - excess - motion[1] / self.p["full_speed"]) / self.p["state_step"]
        beyond = slope - self.slopes.predict(inputs)
        self.learn_excess(inputs, excess, usable)
        self.slopes.update(inputs, np.where(usable, slope, np.nan))
        settle = min(1, self.p["interval"] * self.p["control_period"] / self.p["state_time"])
        theta, told = (np.atleast_2d(m.parameters).copy() for m in (self.learner, self.slopes))
        for j in np.flatnonzero(usable):
            self.power[j] += settle * (beyond[j] ** 2 - self.power[j])
            wish = error[j] * beyond[j] + self.prior[j] * self.moved[j]
            by = -settle * wish / (self.power[j] + self.prior[j])
            now = self.limited(self.shape[j] + by * self.along[j], j)
            by = self.along[j] @ (now - self.shape[j])
            self.shape[j], self.moved[j] = now, self.moved[j] + by
            theta[j] += by * told[j]
        self.learner.parameters = theta.reshape(np.shape(self.learner.parameters))

    def command(self, wanted):
        """What to send (joints,) for commands to the calibrated valves."""
        out = np.empty(self.joints)
        for j, x in enumerate(wanted):
            if abs(x - self.turned[j]) > self.p["turn"]:
                self.way[j], self.turned[j] = np.sign(x - self.turned[j]), x
            shape = self.limited(self.shape[j], j)
            out[j] = self.to_valve(shape, x) + 0.5 * shape[2] * self.way[j]
        return out


class PressureFeedforward(Feedforward):
    """The cascade; `cylinders` are data sheets, `loads` the learner of the load."""

    def __init__(self, parts, table, learner, loads, cylinders):
        super().__init__(parts, table, learner)
        self.loads, self.sheets = loads, [cylinders.joints([j]) for j in range(self.joints)]

    def take(self, pressure_a, pressure_b, supply):
        """Pressures of this period [Pa]; the last ones for what is lost."""
        before = self.measured or (np.zeros(self.joints),) * 2
        new = (pressure_a, pressure_b)
        self.measured = tuple(np.where(np.isnan(n), b, n) for n, b in zip(new, before, strict=True))
        self.supply = self.supply if np.isnan(supply) else supply

    def chambers(self, j, position, pressure):
        """Lever [m/rad] and weights A beta/V [N/m^3] of both chambers."""
        d = self.sheets[j]
        lever = np.interp(position, d.position[0], d.lever[0])
        piston = np.interp(position, d.position[0], d.piston[0])
        volume = [
            d.area[0, 0] * piston + d.dead_volume[0, 0],
            d.area[1, 0] * (d.stroke[0] - piston) + d.dead_volume[1, 0],
        ]
        weights = []
        for p, area, v in zip(pressure, d.area[:, 0], volume, strict=True):
            absolute = p + 101325.0
            gas = d.entrained_air[0] * (101325.0 / absolute) ** (1 / d.polytropic_index[0])
            oil = (1 - d.entrained_air[0]) * np.exp((101325.0 - absolute) / d.bulk_modulus[0])
            slope = gas / (d.polytropic_index[0] * absolute) + oil / d.bulk_modulus[0]
            weights.append(area * (gas + oil) / slope / v)
        return lever, np.array(weights)

    def valve_share(self, j, position, pressure, near, command):
        """Share of full speed at pressures; stiffness and volumes at the pressures `near`."""
        d = self.sheets[j]
        lever, weights = self.chambers(j, position, near)

        def edge(x, drop):
            drop = max(drop, 0.02 * d.supply_pressure[0])
            opening = 0.5 * (x - d.lap[0] + np.hypot(x - d.lap[0], d.edge_rounding[0]))
            root = (drop**2 + d.laminar_transition_pressure[0] ** 2) ** 0.25
            return d.orifice_gain[0] * opening * drop / root

        a, b, tank = *pressure, d.tank_pressure[0]
        flow_a = edge(command, self.supply - a) - edge(-command, a - tank)
        flow_b = edge(-command, self.supply - b) - edge(command, b - tank)
        speed = (weights[0] * flow_a - weights[1] * flow_b) / (weights @ d.area[:, 0])
        return speed / lever / self.p["full_speed"][j]

    def expected(self, j, position, near, load):
        """Pressures with this load, and what each leak path takes at them."""
        d = self.sheets[j]
        lever, (weight_a, weight_b) = self.chambers(j, position, near)
        area_a, area_b = d.area[:, 0]
        full = area_a * d.supply_pressure[0]
        # F = A_A p_A - A_B p_B and the common mode w_B p_A + w_A p_B, solved for both pressures.
        system = np.array([[area_a, -area_b], [weight_b, weight_a]])
        sums = [np.sign(lever) * load * full, weight_b * near[0] + weight_a * near[1]]
        pressure = np.clip(np.linalg.solve(system, sums), 0.0, self.supply)
        stiffness = weight_a * area_a + weight_b * area_b
        scale = np.sign(lever) * area_a / stiffness / d.supply_pressure[0]
        across, out_a, out_b = pressure[0] - pressure[1], pressure[0], pressure[1]
        leaks = [(weight_a + weight_b) * across, weight_a * out_a, -weight_b * out_b]
        return pressure, scale * np.array(leaks)

    def flow(self, position):
        rows = np.array(self.measured).T
        return [
            np.nan
            if np.isnan(position[j])
            else self.valve_share(j, position[j], rows[j], rows[j], self.sent[j])
            for j in range(self.joints)
        ]

    def update(self, inputs, motion, excess, usable, middle):
        command, *pressures = middle
        rows, loads, leaks = np.array(pressures).T, self.loads.predict(inputs), []
        targets = np.empty(self.joints)
        for j in range(self.joints):
            q, near, d = motion[0, j], rows[j], self.sheets[j]
            pressure, leak = self.expected(j, q, near, loads[j])
            leaks.append(leak)
            shares = [self.valve_share(j, q, p, near, command[j]) for p in (pressure, near)]
            excess[j] += shares[0] - shares[1]
            force = d.area[0, 0] * near[0] - d.area[1, 0] * near[1]
            sign = np.sign(np.interp(q, d.position[0], d.lever[0]))
            targets[j] = sign * force / (d.area[0, 0] * d.supply_pressure[0])
        self.loads.update(inputs, np.where(usable, targets, np.nan))
        self.learn_excess(np.hstack([inputs, leaks]), excess, usable)

    def wanted(self, motion, inputs, v):
        rows, loads = np.array(self.measured).T, self.loads.predict(inputs)
        found = [self.expected(j, motion[0, j], rows[j], loads[j]) for j in range(self.joints)]
        leaks = [leak for _, leak in found]
        share = v + self.proof.used(self.count, np.hstack([inputs, leaks]))

        def root(j):
            return brentq(
                lambda u: self.valve_share(j, motion[0, j], found[j][0], rows[j], u) - share[j],
                -10.0,
                10.0,
                xtol=1e-15,
            )

        return [root(j) for j in range(self.joints)]
