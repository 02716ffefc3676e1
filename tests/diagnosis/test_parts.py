"""Parts of the diagnosis against independent references."""

from types import SimpleNamespace

import mujoco
import numpy as np
import pytest

from benchmarks.self_test.exact import Case, Outcome, cases, make, missed, scores
from leglab import DiagnosisSettings, Recording, data, diagnose
from leglab.base.errors import LeglabError
from leglab.diagnosis.effects.base import Effect, EffectParameter, register_effect
from leglab.diagnosis.effects.cogging import wave
from leglab.diagnosis.effects.hypothesis import Hypothesis, Library
from leglab.diagnosis.likelihood.columns import Errors
from leglab.diagnosis.likelihood.unknowns import Unknowns
from leglab.diagnosis.plant.model import Change, ForceLeft, Machine
from leglab.diagnosis.plant.paths import delayed, lagged, play, undo_delay
from leglab.diagnosis.replay import windows
from leglab.diagnosis.replay.residual import extrapolation, thinned, whitened
from leglab.diagnosis.replay.starts import bristle, spool
from leglab.diagnosis.replay.windows import Channel, Cut, noise_level, smoothed
from leglab.diagnosis.result import Gap
from leglab.diagnosis.search.pipeline import set_up
from leglab.diagnosis.verdict.notes import at_limits
from leglab.diagnosis.verdict.sets import Sets
from leglab.diagnosis.verdict.table import Action
from leglab.diagnosis.verdict.verdict import _rivals
from rigs import PENDULUM
from rigs.bench import FAULTS, FaultyBench, detuned, references
from tests.helpers.unpleasant import BENCH


def test_noise_level_of_a_noisy_sine():
    rng = np.random.default_rng(0)
    signal = np.sin(np.linspace(0.0, 40.0, 20000))
    level = noise_level(signal + 0.003 * rng.standard_normal(signal.size), (21, 4))
    assert level == pytest.approx(0.003, rel=0.03)


def test_spool_against_the_step_response():
    w, zeta, period = 2.0 * np.pi * 250.0, 0.7, 1e-3
    command = np.concatenate([np.zeros(3), np.full(12, 0.4)])
    t = period * np.arange(command.size - 3)
    damped = w * np.sqrt(1.0 - zeta**2)
    response = 0.4 * (
        1.0
        - np.exp(-zeta * w * t)
        * (np.cos(damped * t) + zeta / np.sqrt(1.0 - zeta**2) * np.sin(damped * t))
    )
    np.testing.assert_allclose(spool(command, w, zeta, period)[3:, 0], response, atol=1e-12)


def test_bristle_against_the_recursion():
    rng = np.random.default_rng(1)
    velocity = np.cumsum(rng.standard_normal(2000)) * 1e-3
    level, sigma, period = np.full(2000, 120.0), 2e6, 1e-3
    z, exact = 0.0, np.empty(2000)
    for k, v in enumerate(velocity):
        exact[k] = z
        steady = np.sign(v) * 120.0 / sigma
        z = steady + (z - steady) * np.exp(-sigma * abs(v) / 120.0 * period)
    found = bristle(velocity, level, sigma, period)
    np.testing.assert_allclose(found, exact, atol=1e-9)


def test_play_keeps_half_its_width():
    samples = np.array([0.0, 0.3, 0.2, -0.5, -0.4])
    np.testing.assert_allclose(play(samples, 0.2), [0.0, 0.2, 0.2, -0.4, -0.4])


def test_a_sensors_delay_is_undone_with_its_noise():
    """An average of neighbours would let a fit take noise away by half a period of delay."""
    time = 1e-3 * np.arange(4000)
    noise = np.random.default_rng(3).normal(size=time.size)
    for delay in (0.3e-3, 0.5e-3, 2e-3, 7.6e-3):
        inside = slice(50, -50)
        early = undo_delay(delay)(np.sin(30.0 * time), 1e-3)
        np.testing.assert_allclose(early[inside], np.sin(30.0 * (time + delay))[inside], atol=1e-4)
        assert undo_delay(delay)(noise, 1e-3)[inside].std() > 0.95 * noise[inside].std()


def test_delay_between_samples_mixes_neighbours():
    late = delayed(np.arange(6.0), 2.25e-3, 1e-3)
    np.testing.assert_allclose(late, [0.0, 0.0, 0.0, 0.75, 1.75, 2.75])


def test_a_parameter_outside_its_bounds_is_refused():
    with pytest.raises(LeglabError, match=r"'lap': nominal 2 lies outside \[0, 1\]"):
        EffectParameter(name="lap", unit="1", nominal=2.0, lower=0.0, upper=1.0)


def test_an_effect_without_physics_is_refused():
    class Nameless(Effect):
        name = "nameless"
        group = "mechanics"

        def elements(self, machine):
            return ()

        def parameters(self, machine, element):
            return ()

        def apply(self, change, element, values):
            pass

    with pytest.raises(LeglabError, match="has no 'physics'"):
        register_effect(Nameless)


def test_a_channel_is_filtered_once_for_all_hypotheses_that_correct_it_alike(monkeypatch):
    counted = []

    def counting(samples, window, period=None):
        if period is None:
            counted.append(samples[0])
        return smoothed(samples, window, period)

    monkeypatch.setattr(windows, "smoothed", counting)
    channel = Channel(column="q", joint="hinge")
    recorded = SimpleNamespace(period=1e-3)
    cut = Cut(series=recorded, firsts=np.arange(3), levers={}, touched={}, pushes=None)
    rng = np.random.default_rng(0)
    series = [np.concatenate([[k], rng.standard_normal(99)]) for k in range(5)]
    for k in (0, 1, 0, 2, 0, 3, 0, 1):
        level, slope = cut.filtered(channel, series[k].copy())
        np.testing.assert_array_equal(level, smoothed(series[k], channel.filter))
        np.testing.assert_array_equal(slope, smoothed(series[k], channel.filter, 1e-3))
    # The one that all come back to stays, one of long ago is made anew.
    assert counted == [0.0, 1.0, 2.0, 3.0, 1.0]


@pytest.mark.parametrize("name", sorted(FAULTS))
def test_every_fault_shows_in_the_recording(name):
    reference = references(np.random.default_rng(6), duration=0.8)["walk"]
    healthy = FaultyBench().record(reference, np.random.default_rng(7))
    plant = FaultyBench()
    FAULTS[name](plant, np.random.default_rng(8))
    ill = plant.record(reference, np.random.default_rng(7))
    columns = ("knee_position", "knee_valve_command", "knee_pressure_a", "knee_pressure_b")
    assert any(not np.array_equal(healthy[c], ill[c]) for c in columns)


def test_a_case_is_fixed_by_its_number_and_the_seed():
    plant, again = FaultyBench(), FaultyBench()
    detuned(plant, np.random.default_rng(9))
    detuned(again, np.random.default_rng(9))
    assert plant.tuning == again.tuning
    listed = cases({"single": 3, "null": 1, "pair": 2}, 0, ("payload", "stiction"))
    assert [c.effects for c in listed[:3]] == [("payload",), ("stiction",), ("payload",)]
    assert listed[3].effects == ()
    assert all(len(set(c.effects)) == 2 for c in listed[4:])


def test_made_case_has_four_recordings_and_its_severity(monkeypatch):
    import benchmarks.self_test.exact as selftest

    monkeypatch.setattr(selftest, "references", lambda rng: {"walk": references(rng, 0.3)["walk"]})
    found, (severity,) = make(Case(kind="single", number=0, effects=("stiction",)), 1)
    assert found["walk"].duration == pytest.approx(0.299)
    assert severity.parameter == "static"
    assert severity.value > 150.0


@pytest.mark.slow("two whole diagnoses with all effects")
@pytest.mark.parametrize("number", [1, 2])
def test_nothing_is_missing_of_a_machine_within_its_tolerances(number):
    """Viscosity, leakage and friction make up for each other: fits must not stop half way."""
    result, _ = diagnose("knee_bench", make(Case(kind="null", number=number, effects=()), 9001)[0])
    assert (result.verdict, result.effects) == ("nothing_missing", ())


def outcome(kind, hidden, named, **fields):
    given = {"alternatives": ((),), "confidence": (1.0,)} if named else {}
    given = {"alternatives": (), "confidence": (), "verdict": "named", "onsets": ()} | given
    given |= {"severities": (), "covered": (), "before": 2.0, "after": 1.0, "seconds": 1.0}
    return Outcome(kind=kind, number=0, hidden=hidden, named=named, **given | fields)


@pytest.mark.parametrize(
    ("onsets", "intervals", "right", "told"),
    [
        ((6.0, 5.8), ((6.0, 6.0), (5.6, 5.9)), True, True),
        ((6.0, 4.3), ((6.0, 6.0), (2.1, 6.5)), False, True),
        ((6.0, 4.3), ((6.0, 6.0), (4.2, 4.4)), False, False),
        ((), (), False, False),
    ],
)
def test_an_onset_that_is_off_must_be_told_as_an_interval_that_holds_it(
    onsets, intervals, right, told
):
    one = outcome("onset", ("a",), ("a",), onsets=onsets, onset_intervals=intervals)
    assert (one.onset_right, one.onset_told) == (right, told)
    shares = dict(row[:2] for row in scores([one]))
    assert shares["... or in an interval that is told instead"].startswith(str(int(told)))


def test_scores_count_sets_and_false_alarms():
    right = outcome("single", ("a",), ("a",))
    tied = outcome("single", ("a",), ("b",), alternatives=(("a",),))
    wrong = outcome("single", ("a",), ("b",))
    alarm = outcome("null", (), ("b",))
    unknown = outcome("removed", ("a",), ("b",), verdict="unexplained", confidence=(0.2,))
    assert right.first
    assert right.found
    assert tied.found
    assert not tied.first
    assert not wrong.found
    assert unknown.honest
    assert not alarm.first
    every = [right, tied, wrong, alarm, unknown]
    assert [row[1] for row in scores(every)][:3] == ["1 (33%)", "2 (67%)", "1 (100%)"]
    assert missed(every) == [("a", "b", "named", "2")]


def test_the_order_of_the_step_error_is_measured():
    """Errors of c_1 h + c_2 h^2 + noise; one channel of each order, and one of both."""
    rng = np.random.default_rng(4)
    first, second = rng.normal(size=(2, 40, 1, 30))

    def error(h):
        return np.concatenate([first * h, second * h**2, first * h + second * h**2], axis=1)

    half, quarter = error(0.5) - error(1.0), error(0.25) - error(0.5)
    factors = extrapolation(half, quarter)
    assert factors[:2] == pytest.approx([2.0, 4.0 / 3.0])
    assert 4.0 / 3.0 < factors[2] < 2.0
    np.testing.assert_allclose(half[:, 0] * factors[0], -error(1.0)[:, 0])
    # A window beside a jump, where differences have no order, does not count.
    half[7], quarter[7] = 100.0 * rng.normal(size=(2, 3, 30))
    assert extrapolation(half, quarter)[:2] == pytest.approx([2.0, 4.0 / 3.0], abs=1e-6)


def test_the_period_of_a_force_is_found_beside_friction_and_a_spring():
    rng = np.random.default_rng(3)
    q = 0.9 + 0.3 * np.sin(np.arange(3000) * 0.011) + 0.05 * np.sin(np.arange(3000) * 0.037)
    v, a = np.gradient(q, 0.015), np.gradient(np.gradient(q, 0.015), 0.015)
    other = 3.0 * np.sign(v) + 20.0 * (q - 0.9) - 8.0 * q**2 + 0.4 * v + 0.2 * a
    ripple = 1.2 * np.sin(2 * np.pi * q / 0.137) + 0.5 * np.cos(2 * np.pi * q / 0.137)
    force = ripple + other + rng.normal(0.0, 2.0, q.size)
    force[::97] += 400.0
    found = wave(ForceLeft(q, v, a, force))
    assert found["period"] == pytest.approx(0.137, rel=0.02)
    assert np.hypot(found["sine"], found["cosine"]) == pytest.approx(1.3, abs=0.25)
    still = np.zeros(100)
    assert wave(ForceLeft(still, still, still, still)) is None


def test_a_lag_a_rounding_error_below_zero_is_none():
    samples = np.array([0.0, 1.0, 0.5])
    assert lagged(samples, -1e-20, 0.001).tolist() == samples.tolist()
    assert lagged(samples, 0.002, 0.001)[1] < 1.0


AXIS = """<mujoco><option timestep="0.001" integrator="implicitfast"/><worldbody><body>
<joint name="axis" type="slide" axis="1 0 0" armature="0.4" damping="6"/>
<geom type="box" size="0.05 0.04 0.02" mass="2"/></body></worldbody>
<actuator><motor name="drive" joint="axis" ctrllimited="true" ctrlrange="-80 80"/></actuator>
</mujoco>"""


def test_held_out_is_chosen_where_nobody_names_it(tmp_path):
    path = tmp_path / "axis.xml"
    path.write_text(AXIS)
    model = mujoco.MjModel.from_xml_string(AXIS)

    def record(rate, seed):
        data, rng = mujoco.MjData(model), np.random.default_rng(seed)
        rows = []
        for k in range(2000):
            goal = 0.1 * np.sin(rate * 1e-3 * k)
            data.ctrl[0] = 600.0 * (goal - data.qpos[0]) - 20.0 * data.qvel[0]
            rows.append((data.qpos[0] + rng.normal(0.0, 5e-5), data.ctrl[0]))
            data.qfrc_applied[0] = -1.5
            mujoco.mj_step(model, data)
        position, command = np.array(rows).T
        columns = {"axis_position": position, "drive_command": command}
        return Recording(time=1e-3 * np.arange(len(rows)), columns=columns)

    recordings = {"slow": record(2.0, 1), "middle": record(4.0, 2), "fast": record(7.0, 3)}
    settings = DiagnosisSettings(effects=("force_offset",))
    result, _ = diagnose(path, recordings, settings=settings)
    assert [effect.name for effect in result.effects] == ["force_offset"]
    (held,) = result.gap.held_out
    named, _ = diagnose(path, recordings, held_out=[held], settings=settings)
    assert named.to_json() == result.to_json()
    alone, _ = diagnose(path, {"fast": recordings["fast"]}, settings=settings)
    assert alone.gap.held_out == ("fast (end)",)


def test_a_fit_that_ended_at_a_limit_of_its_effect_is_told():
    library = Library(Machine("knee_bench"))
    key = ("valve_bandwidth", "knee_valve")
    site = library.sites[key]
    assert at_limits(library, {key: site.nominal}) == ()
    assert at_limits(library, {key: np.array([40.0, 1.5])}) == ()
    (line,) = at_limits(library, {key: np.array([40.0, site.upper[1]])})
    assert line.startswith("valve_bandwidth at knee_valve: damping_ratio ended at 5.6, the largest")
    (line,) = at_limits(library, {key: np.array([site.lower[0] * 1.01, 1.5])})
    assert "bandwidth_hz ended at 3.75 Hz, the smallest" in line
    # Where nothing of it is at work an effect is at home, though that is an end as well.
    leak = ("external_leakage", "knee_valve")
    assert at_limits(library, {leak: np.array([0.0, 1e-12])}) == ()


def test_effects_that_lower_the_same_parameter_end_where_the_plugin_does():
    machine = Machine("knee_bench")
    for name, most, least in (
        ("stribeck_velocity", 10.0, 0.001),  # must be more than zero
        ("stribeck_exponent", 20.0, 0.0),
        ("viscous", 1e6, 0.0),
    ):
        row = machine.base.elements["knee_valve"][1].parameters[name]
        own = machine.parameter("knee_valve", name)
        for differences, end in (
            ((-0.6 * own, -0.6 * own), row.minimum + least * own),
            ((1e7, 1e7), most),
            ((0.2 * own, -0.1 * own), 1.1 * own),
        ):
            change = Change(machine)
            for difference in differences:
                change.add_parameter("knee_valve", name, difference)
            assert change.parameter("knee_valve", name) == pytest.approx(end)


def a_gap(**levels):
    given = {"before": 10.0, "baseline": 10.0, "after": 1.0, "held_out": ("c",), **levels}
    return Gap(**given)


def test_explained_is_the_share_of_what_noise_or_the_healthy_machine_did_not_show():
    assert a_gap(unnamed=10.0, after=4.0).explained == pytest.approx(6.0 / 9.0)
    assert a_gap(unnamed=10.0, after=0.9).explained == 1.0
    assert a_gap(unnamed=10.0, after=11.0).explained == 0.0
    # Noise levels do not count where errors of the healthy machine do.
    as_healthy = a_gap(unnamed=10.0, after=9.0, healthy=9.0, compared=(5.0, 2.0, 1.0))
    assert as_healthy.explained == pytest.approx(0.75)
    assert a_gap(unnamed=10.0, after=9.0, compared=(1.0, 1.0, 1.0)).explained is None
    assert a_gap(after=4.0).explained is None


def test_a_bandwidth_counts_by_its_lag():
    trials = (12.5, 50.0, 125.0)
    bandwidth = EffectParameter(
        "f", "Hz", nominal=250.0, lower=5.0, upper=500.0, trials=trials, inverse=True
    )
    # 1/f is 4 ms as built, and 80, 20 and 8 ms.
    assert [bandwidth.departure(f, 250.0) for f in trials] == pytest.approx([19.0, 4.0, 1.0])
    assert bandwidth.departure(500.0, 250.0) == pytest.approx(0.5)
    assert bandwidth.moved(250.0, -4.0) == pytest.approx(50.0)
    assert bandwidth.moved(50.0, 3.0) == pytest.approx(125.0)
    assert (bandwidth.moved(50.0, 90.0), bandwidth.moved(50.0, -90.0)) == (500.0, 5.0)
    assert bandwidth.step(50.0) == pytest.approx(bandwidth.moved(50.0, 1e-6) * 1e6 - 50e6, rel=1e-4)


@pytest.mark.parametrize(
    ("confidence", "said", "honest"),
    [(0.95, "named", False), (0.6, "partial", False), (0.3, "partial", True)],
)
def test_a_wrong_name_given_with_confidence_is_no_doubt(confidence, said, honest):
    one = outcome("removed", ("a",), ("b",), confidence=(confidence,), verdict=said)
    assert one.honest == honest
    rows = {row[0]: row[1] for row in scores([one])}
    assert rows["effect unknown to the library: doubt"] == ("1 (100%)" if honest else "0 (0%)")
    sure = "1 (100%)" if confidence > 0.9 else "0 (0%)"
    assert rows["... and a wrong name given for sure"] == sure


def test_a_wrong_name_of_a_single_fault_counts_as_wrong():
    seen = [
        outcome(kind, hidden, ("b",), confidence=(0.2,), verdict="partial")
        for kind, hidden in (("single", ("a",)), ("null", ()))
    ]
    rows = {row[0]: row[1] for row in scores(seen)}
    assert rows["single effect named first"] == "0 (0%)"
    assert rows["single effect named or in a set of 3"] == "0 (0%)"
    assert rows["false alarms where nothing is hidden"] == "1 (100%)"


OFFSET, VISCOUS = ("force_offset", "hinge"), ("viscous_friction", "hinge")
OWN = {OFFSET: np.array([0.3]), VISCOUS: np.array([0.1])}


def test_a_library_is_about_the_values_of_its_specimen():
    machine = Machine(PENDULUM.model)
    library, coulomb = Library(machine), ("coulomb_friction", "hinge")
    about = Library(machine, specimen=OWN)
    assert about.sites[OFFSET].nominal == [0.3]
    assert about.sites[OFFSET].model == [0.0]
    assert about.sites[coulomb].nominal == [0.0]
    assert dict(about.neutral()) == {OFFSET: [0.0], VISCOUS: [0.08]}
    assert about.whole({OFFSET: np.array([0.5])}) == {OFFSET: [0.5], VISCOUS: [0.1]}
    assert about.whole({}) == OWN
    same = about.change({}, machine).edits, library.change(OWN, machine).edits
    assert len(same[0]) == len(same[1]) > 0
    assert library.sites[OFFSET].nominal == [0.0]  # the first one stays as it was
    assert not library.neutral()
    unused = Library(machine, names=["payload"], specimen=OWN)
    assert unused.names == ("payload",)
    assert OFFSET in unused.sites


def test_a_little_of_an_effect_that_good_machines_have_changes_little():
    """Unknowns beside a set depart a little: one that jumps there would stop every fit."""
    names = ("slow", "walk")
    logs = {name: data.read(BENCH / f"d2_{name}.parquet") for name in names}
    problem = set_up("knee_bench", logs, (), DiagnosisSettings(threads=1))
    unknowns = Unknowns.of(problem.library)
    at = Errors(problem, unknowns, thinned(problem.fitted, 8))
    # Off its model a little everywhere, as a fit finds it.
    little = {i: 0.1 for i in range(unknowns.single) if unknowns.gradual[i]}
    little = {i: d for i, d in little.items() if not unknowns.shape[i] and unknowns.upper[i] > d}

    def moved(i, by):
        base = unknowns.moved(Hypothesis(), {k: d for k, d in little.items() if k != i})
        change = at.at(unknowns.moved(base, {i: by})) - at.at(base)
        return np.linalg.norm(whitened(problem.noise.whitening[at.chosen], change[:, : at.size]))

    for i in little:
        assert moved(i, 1e-5) < 0.05 * moved(i, 0.3) + 0.01, unknowns.keys[i]
    # Of what is there or is not, the first trace says it is there.
    absent = [i for i in range(unknowns.single) if not unknowns.gradual[i] and unknowns.nameable[i]]
    assert {unknowns.keys[i][0] for i in absent} == {"backlash", "command_saturation"}


def test_sets_of_the_same_effects_are_told_apart_by_their_elements():
    sets = [{("gain", "hip")}, {("gain", "knee")}, {("gain", "hip"), ("play", "hip")}, set()]
    score = SimpleNamespace(log=0.0)
    rows = [SimpleNamespace(keys=frozenset(one), score=score, level=1.0) for one in sets]
    assert _rivals(rows).names == ("gain at hip", "gain at knee", "gain + play", "nothing")


def test_an_effect_explains_the_windows_in_which_it_acts():
    rng = np.random.default_rng(0)
    left = rng.normal(size=(20, 1))
    without = left.copy()
    without[[3, 9, 15]] += 30.0  # a limit that binds in three of twenty windows
    at = SimpleNamespace(recording=np.zeros(20, dtype=int), size=10)
    sets = SimpleNamespace(
        at=at,
        channels=1,
        elsewhere=None,
        _roots=None,
        without=lambda row, key: without,
        channel_squares=lambda errors, roots: errors**2,
    )
    ((_, medians),) = Sets.shown(sets, SimpleNamespace(left=left), ("force_saturation", "knee"))
    left, without, change = medians.tolist()
    acted = Action(numbers=(200,), left=left, without=without, change=change)
    assert min(acted.explained) > 0.95
