"""The bank of faults: least squares along curves, and how it is made and kept."""

from dataclasses import replace

import numpy as np
import pytest

import leglab.runs.fault_simulation as making
from leglab import RunSettings
from leglab._native.monitor import chances
from leglab.base.errors import LeglabError
from leglab.base.scenario import get_scenario
from leglab.causes.fault_names import ALL
from leglab.causes.record import Side
from leglab.causes.table import CAUSES
from leglab.control.feedforward.fault_bank import FaultBank, FaultCurve, Moments
from leglab.control.feedforward.judge import explained_share
from leglab.machine.changes import Schedule
from leglab.machine.simulation import Simulation, load_model
from leglab.runs.loop import Loop
from leglab.runs.preparation import scenario_of

JOINTS, PARAMETERS = 3, 5


def curve(rng, fault="wear", element=ALL, sizes=(1.0, 3.0, 10.0), scale=1.0) -> FaultCurve:
    shifts = scale * rng.standard_normal((len(sizes), JOINTS, PARAMETERS))
    shifts[0] = 0.0
    return FaultCurve(
        fault=fault, element=element, meaning="", sizes=np.array(sizes), shifts=shifts
    )


def samples(rng, parameters, count=40, noise=0.0):
    regressor = rng.standard_normal((count, JOINTS, PARAMETERS))
    output = np.einsum("njp,jp->nj", regressor, parameters)
    return regressor, output + noise * rng.standard_normal((count, JOINTS))


def moments(regressor, output) -> Moments:
    sums = Moments(*regressor.shape[1:])
    sums.add(rows(regressor, output))
    return sums


def rows(regressor, output):
    """Samples as a learner keeps them; its errors do not matter."""
    rest = np.stack([output, np.zeros(output.shape), np.ones(output.shape)], axis=-1)
    return np.concatenate([regressor, rest], axis=-1)


@pytest.mark.parametrize("size", [1.7, 3.0, 8.0])
def test_a_planted_size_is_found_on_a_bent_curve(size):
    rng = np.random.default_rng(1)
    planted = curve(rng)
    bank = FaultBank(curves=(curve(rng, "other"), planted))
    base = rng.standard_normal((JOINTS, PARAMETERS))
    seen = moments(*samples(rng, base + planted.shift(size))).about(base)
    fit = bank.fit(seen, np.array([1.0, 0.5, 2.0]), 0.15)
    assert fit.size[1] == pytest.approx(size, rel=1e-9)
    assert fit.cost[1] == pytest.approx(0.0, abs=1e-9 * fit.without)
    assert fit.cost[0] > 0.1 * fit.without


def test_size_and_cost_are_those_of_a_fine_search_with_noise_and_weights():
    rng = np.random.default_rng(2)
    bank = FaultBank(curves=tuple(curve(rng, f"fault_{i}") for i in range(4)))
    base, weight = rng.standard_normal((JOINTS, PARAMETERS)), np.array([1.0, 3.0, 0.2])
    true = base + rng.standard_normal((JOINTS, PARAMETERS))
    regressor, output = samples(rng, true, noise=0.3)
    fit = bank.fit(moments(regressor, output).about(base), 1.0 / weight, 0.0)

    def cost(shift):
        error = output - np.einsum("njp,jp->nj", regressor, base + shift)
        return float(weight @ np.sum(error**2, axis=0))

    assert fit.without == pytest.approx(cost(0.0))
    for number, each in enumerate(bank.curves):
        grid = np.linspace(each.sizes[0], each.sizes[-1], 20_001)
        costs = [cost(each.shift(size)) for size in grid[::20]]
        assert fit.cost[number] <= min(costs) + 1e-9
        assert fit.cost[number] == pytest.approx(cost(each.shift(fit.size[number])))


def test_spread_is_the_step_that_raises_the_cost_by_one():
    rng = np.random.default_rng(3)
    planted = curve(rng)
    bank, weight = FaultBank(curves=(planted,)), np.ones(JOINTS)
    regressor, output = samples(rng, planted.shift(5.0), noise=0.01)
    fit = bank.fit(moments(regressor, output), weight, 0.0)
    moved = moments(regressor, output).about(planted.shift(fit.size[0] + fit.spread[0]))
    assert float(weight @ moved.power) - fit.cost[0] == pytest.approx(1.0, rel=1e-6)


def test_sizes_may_fall_and_shifts_beyond_the_ends_are_those_of_the_ends():
    rng = np.random.default_rng(4)
    cold = curve(rng, sizes=(40.0, 15.0, 0.0))
    np.testing.assert_allclose(cold.shift(15.0), cold.shifts[1])
    np.testing.assert_allclose(cold.shift(7.5), (cold.shifts[1] + cold.shifts[2]) / 2)
    np.testing.assert_allclose(cold.shift(-20.0), cold.shifts[2])
    np.testing.assert_allclose(cold.shift(60.0), 0.0)


def test_moments_of_parts_are_those_of_the_whole():
    rng = np.random.default_rng(5)
    base = rng.standard_normal((JOINTS, PARAMETERS))
    regressor, output = samples(rng, base, noise=0.1)
    whole, parts = moments(regressor, output), moments(regressor[:17], output[:17])
    parts.add(rows(regressor[17:], output[17:]))
    for name in ("information", "correlation", "power", "count"):
        np.testing.assert_array_equal(getattr(parts, name), getattr(whole, name))
    error = output - np.einsum("njp,jp->nj", regressor, base)
    np.testing.assert_allclose(whole.about(base).power, np.sum(error**2, axis=0))


def test_what_is_no_curve_is_refused():
    rng = np.random.default_rng(6)
    good = curve(rng)
    for change, message in (
        ({"sizes": np.array([1.0, 3.0, 2.0])}, "not monotone"),
        ({"sizes": np.array([1.0, 3.0])}, "have shape"),
        ({"shifts": good.shifts + 1.0}, "zero at the healthy size"),
    ):
        with pytest.raises(LeglabError, match=message):
            FaultCurve(**{**vars(good), **change})
    with pytest.raises(LeglabError, match="'rust' is not in the bank"):
        FaultBank(curves=(good,)).without(["rust"])
    with pytest.raises(LeglabError, match="no fault would be left"):
        FaultBank(curves=(good,)).without(["wear"])


def test_changes_of_one_joint_are_those_of_its_cylinder_and_spring():
    machine = Simulation(load_model("leg", visual=False))

    def changed(scenario, joint):
        return set(Schedule(get_scenario(scenario, element=joint), machine).parameters)

    assert changed("seal_wear", "knee") == {("knee_valve", "internal_leakage")}
    assert changed("spring_fatigue", "knee") == {("knee_spring", "k1"), ("knee_spring", "k2")}
    assert {element for element, _ in changed("seal_wear", None)} == {
        f"{joint}_valve" for joint in machine.joints
    }
    with pytest.raises(LeglabError, match="of 'hip_yaw,.*parameter of .*knee_spring"):
        changed("spring_fatigue", "hip_yaw")


@pytest.fixture
def small(tmp_path, monkeypatch):
    """A cache of its own, and two faults alone."""
    monkeypatch.setenv("LEGLAB_CACHE", str(tmp_path))
    monkeypatch.setattr(making, "_banks", {})
    causes = {name: CAUSES[name] for name in ("seal_wear", "supply_drop")}
    monkeypatch.setattr(making, "CAUSES", causes)
    return tmp_path


def one_side(**steps):
    """Rows of the table with these steps in the bank."""
    sides = {name: (Side(bank, (0.0, 0.0, 0.0)),) for name, bank in steps.items()}
    return {name: replace(CAUSES[name], sides=side) for name, side in sides.items()}


def bank_of(**changed) -> FaultBank:
    settings = RunSettings(
        **{"scenario": "nominal", "controller": "bsnn_arx_bank", "model": "knee_bench", **changed}
    )
    return making.fault_bank(settings, scenario_of(settings), Loop)


def same(one: FaultBank, other: FaultBank) -> bool:
    return all(
        (a.fault, a.explains) == (b.fault, b.explains) and np.array_equal(a.shifts, b.shifts)
        for a, b in zip(one.curves, other.curves, strict=True)
    )


def test_bank_is_of_the_nominal_machine_whatever_the_run_does_to_its_own(small, monkeypatch):
    first = bank_of()
    (file,) = small.iterdir()
    for changed in (
        {"scenario": "seal_wear", "severity": 30.0},
        {"tolerance": 0.3, "seed": 7, "vary": True},
    ):
        monkeypatch.setattr(making, "_banks", {})
        file.unlink(missing_ok=True)
        assert same(first, bank_of(**changed))
    # Another motion is another bank.
    monkeypatch.setattr(making, "_banks", {})
    assert not same(first, bank_of(reference_config={"period": 1.5}))


def test_kept_bank_is_read_and_a_damaged_one_is_made_anew(small, monkeypatch):
    first = bank_of()
    (file,) = small.iterdir()

    def refuse(*_, **__):
        raise AssertionError("made again")

    with monkeypatch.context() as patch:
        patch.setattr(making, "_banks", {})
        patch.setattr(making, "_make", refuse)
        assert same(first, bank_of())
    file.write_bytes(file.read_bytes()[:100])
    monkeypatch.setattr(making, "_banks", {})
    assert same(first, bank_of())


def test_a_bank_of_other_code_is_replaced(small, monkeypatch):
    bank_of()
    monkeypatch.setattr(making, "_banks", {})
    monkeypatch.setattr(making, "fingerprint", lambda: "other")
    made = []
    real = making._make
    monkeypatch.setattr(making, "_make", lambda *a: made.append(1) or real(*a))
    bank_of()
    monkeypatch.setattr(making, "_banks", {})
    bank_of()
    assert made == [1]
    assert len(list(small.iterdir())) == 1


def test_a_fault_that_changes_nothing_shifts_nothing(small, monkeypatch):
    """What the ridge takes off a map's own parameters is in no shift."""
    monkeypatch.setattr(making, "CAUSES", one_side(seal_wear=(1.0 + 1e-9, 10.0)))
    (curve,) = bank_of().curves
    worn = np.abs(curve.shifts[2]).max()
    assert np.abs(curve.shifts[1]).max() < 1e-3 * worn


def test_odds_are_those_of_noise_or_of_structure_whichever_are_weaker():
    """More samples tell noise apart, and not what another machine than the nominal one leaves."""
    cost = np.array([300.0, 200.0])

    def rival(correlation, independent=0.0, noise=0.0):
        return chances(cost, [0, 1], correlation, independent, noise)[0]

    def odds(log):
        return pytest.approx(1.0 / (1.0 + np.exp(log)))

    assert rival(20.0) == odds(100.0 / 40.0)
    assert rival(20.0, 10.0) == odds(5.0 * np.log(1.5))
    assert rival(50.0, 10.0) == odds(100.0 / 100.0)
    assert chances(0.0 * cost, [0, 1], 20.0, 10.0, 0.0).tolist() == [0.5, 0.5]
    # What noise makes of both is no likeness: a fifth of it is not known, and it is at most what
    # the best leaves.
    assert rival(1.0, 10.0, 150.0) == odds(5.0 * np.log(180 / 80))
    assert rival(1.0, 10.0, 250.0) == odds(5.0 * np.log(140 / 40))
    assert rival(1.0, 0.0, 150.0) == odds(100.0 / 2.0)


def test_explained_is_the_share_of_what_is_beyond_noise():
    assert explained_share(40.0, 100.0, 20.0) == pytest.approx(60.0 / 80.0)
    assert explained_share(10.0, 100.0, 20.0) == 1.0
    assert explained_share(110.0, 100.0, 20.0) == 0.0
    assert explained_share(10.0, 100.0, 100.0) == 0.0


def test_a_bank_knows_how_much_a_map_can_say_of_each_fault(small, monkeypatch):
    """A leak is a function of the motion; soft oil shakes, which the motion hardly tells."""
    monkeypatch.setattr(making, "CAUSES", one_side(seal_wear=(10.0,), air_in_oil=(0.145,)))
    leak, air = bank_of().curves
    assert leak.explains > 0.95
    assert 0.1 < air.explains < 0.9
