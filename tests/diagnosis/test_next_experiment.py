"""Experiments that tell causes apart: a pendulum in space, whose motor gain and inertia only a known load separates."""

import json
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest

from leapgap.diagnosis.candidates import Candidate, Rival
from leapgap.diagnosis.diagnose import diagnose
from leapgap.diagnosis.experiment_forecast import Forecast, Forecaster, Separation, largest_difference
from leapgap.diagnosis.experiment_plans import Given, is_possible
from leapgap.diagnosis.experiments import (
    Experiment,
    candidates_for,
    experiment_of,
    known_load,
    other_gains,
    other_jumps,
    other_speed,
    plans_of,
    repetition,
    sines,
)
from leapgap.diagnosis.hypotheses import Hypothesis
from leapgap.diagnosis.judged_logs import JudgedLogs
from leapgap.diagnosis.next_experiment import sharpen, tells_apart
from leapgap.diagnosis.outside_forces.model_errors import inverse_dynamics, without_constraints
from leapgap.diagnosis.outside_forces.residuals import instants_of, without_loads
from leapgap.diagnosis.settings import Settings
from leapgap.effects.base import Effect
from leapgap.effects.friction import Armature, JointDamping, JointFriction
from leapgap.effects.motors import TorqueGain
from leapgap.errors import InputError
from leapgap.logs.log import Log, LogInfo
from leapgap.logs.state import States, motion_of
from leapgap.robot.model import Robot
from leapgap.robot.motion import Motion
from leapgap.simulation.replay import Replayer
from leapgap.simulation.rollout import Rollout

ROD = """<mujoco model="rod">
  <option timestep="0.0005" gravity="0 0 0"/>
  <worldbody>
    <body name="rod">
      <joint name="hinge" axis="0 0 1" range="-90 90" limited="true" armature="0.02" damping="{damping}"/>
      <geom type="capsule" fromto="0 0 0 0.4 0 0" size="0.02" mass="1" contype="0" conaffinity="0"/>
    </body>
  </worldbody>
  <actuator><motor joint="hinge" ctrlrange="-30 30" forcerange="-30 30"/></actuator>
</mujoco>
"""
PERIOD_S, KP, KD, GAIN = 0.002, 20.0, 1.0, 0.8
ANGLE_NOISE, SPEED_NOISE = 3e-4, 1e-2


def swing(seed: int, gain: float = 1.0, damping: float = 0.0, triangle: bool = False, rows: int = 800) -> Log:
    """A log by plain MuJoCo of a joint PD that a motor scales by ``gain``; sines, or a triangle of constant speed."""
    rng = np.random.default_rng(seed)
    model = mujoco.MjModel.from_xml_string(ROD.format(damping=damping))
    data, time = mujoco.MjData(model), np.arange(rows) * PERIOD_S
    rate = 1.0 + 0.2 * seed
    wanted = 0.5 * np.sin(2 * np.pi * rate * time)
    if triangle:
        wanted = 0.3 - 0.6 * np.abs((time + 0.25 * (1 + 0.1 * seed)) % 1.0 - 0.5) * 2
    speed = np.gradient(wanted, PERIOD_S)
    data.qpos[0], data.qvel[0] = wanted[0], speed[0]
    position, velocity = np.empty(rows), np.empty(rows)
    for row in range(rows):
        position[row], velocity[row] = data.qpos[0], data.qvel[0]
        for _ in range(round(PERIOD_S / model.opt.timestep)):
            data.ctrl[0] = gain * (KP * (wanted[row] - data.qpos[0]) + KD * (speed[row] - data.qvel[0]))
            mujoco.mj_step(model, data)
    columns = {
        "time": time,
        "joint_pos/hinge": position + ANGLE_NOISE * rng.standard_normal(rows),
        "joint_vel/hinge": velocity + SPEED_NOISE * rng.standard_normal(rows),
        "cmd_tau/hinge": np.zeros(rows),
        "cmd_pos/hinge": wanted,
        "cmd_vel/hinge": speed,
        "cmd_kp/hinge": np.full(rows, KP),
        "cmd_kd/hinge": np.full(rows, KD),
    }
    return Log(f"swing_{seed}", columns, LogInfo("rod", PERIOD_S, "plain MuJoCo"))


@pytest.fixture(scope="module")
def rod(tmp_path_factory: pytest.TempPathFactory) -> Robot:
    path = tmp_path_factory.mktemp("rod") / "rod.xml"
    path.write_text(ROD.format(damping=0.0))
    return Robot.load(path)


def fit(robot: Robot, kind: type[Effect], number: float, spread: float) -> Candidate:
    return Candidate((Hypothesis(kind, robot),), np.array([number]), np.array([[spread**2]]), np.array([[number]]))


def forecaster(logs: list[Log], robot: Robot, answer: Candidate, rival: Candidate) -> Forecaster:
    judged = JudgedLogs.of(logs, robot)
    rivals = (Rival(rival.names[0], rival),)
    return Forecaster(judged, Replayer(robot), Settings(tolerances={}), answer.names[0], answer, rivals)


def inertia(robot: Robot) -> float:
    """Inertia about the hinge, kg·m², by MuJoCo."""
    return float(robot.model.dof_M0[0])


@pytest.fixture(scope="module")
def weak_or_heavy(rod: Robot) -> Forecaster:
    """A motor that gives 0.8 of its torque, or a rotor that makes the inertia 1/0.8: the same motion at any command."""
    logs = [swing(seed, GAIN) for seed in range(3)]
    heavy = inertia(rod) * (1 / GAIN - 1)
    return forecaster(logs, rod, fit(rod, TorqueGain, GAIN, 0.005), fit(rod, Armature, heavy, 0.0002))


@pytest.mark.parametrize(
    ("kind", "numbers"),
    [(repetition, ()), (other_gains, (2.0,)), (other_speed, (2.0,)), (sines, (("hinge",), (0.1,), 3.0))],
)
def test_no_motion_tells_a_weak_motor_from_a_heavy_rotor(
    weak_or_heavy: Forecaster, kind: Callable[..., Experiment], numbers: tuple[object, ...]
) -> None:
    found = weak_or_heavy.forecast(kind(weak_or_heavy.given, *numbers))
    assert found is not None
    assert found.least < 1


def test_a_known_load_does(weak_or_heavy: Forecaster) -> None:
    """The load adds the same inertia to both, which is not the same share of theirs."""
    found = weak_or_heavy.forecast(known_load(weak_or_heavy.given, "hinge", "rod", 0.3))
    assert found is not None
    assert found.least > 60
    assert found.separations[0].noises > 0.5
    assert found.separations[0].channel in ("joint_pos/hinge", "joint_vel/hinge")


def test_another_speed_tells_damping_from_coulomb_friction(rod: Robot) -> None:
    """At one speed both are the same torque; at twice the speed one of them is twice as large."""
    speed = 1.2  # of the triangle, rad/s
    logs = [swing(seed, damping=0.3, triangle=True) for seed in range(3)]
    damped, rubbed = fit(rod, JointDamping, 0.3, 0.02), fit(rod, JointFriction, 0.3 * speed, 0.02)
    both = forecaster(logs, rod, damped, rubbed)
    same, faster = (both.forecast(one) for one in (repetition(both.given), other_speed(both.given, 2.0)))
    assert same is not None and faster is not None
    assert faster.least > 3 * same.least


def test_a_rival_adapts_its_number_as_far_as_the_logs_leave_it_open(rod: Robot) -> None:
    """The same rival with a number that nobody knows follows the answer further."""
    logs = [swing(seed, damping=0.3, triangle=True) for seed in range(3)]
    known, unknown = (
        of.forecast(other_speed(of.given, 2.0))
        for of in (
            forecaster(logs, rod, fit(rod, JointDamping, 0.3, 0.02), fit(rod, JointFriction, 0.36, spread))
            for spread in (0.001, 0.5)
        )
    )
    assert known is not None and unknown is not None
    assert unknown.least < 0.8 * known.least


def test_what_tolerances_of_the_model_could_do_does_not_count(rod: Robot) -> None:
    """The rotor's own inertia, known to a multiple of itself, makes the load no evidence."""
    logs = [swing(seed, GAIN) for seed in range(3)]
    heavy = fit(rod, JointFriction, 0.2, 0.01)
    judged, rivals = JudgedLogs.of(logs, rod), (Rival("joint_friction", heavy),)
    sure, unsure = (
        Forecaster(
            judged,
            Replayer(rod),
            Settings(tolerances=tolerances),
            "torque_gain",
            fit(rod, TorqueGain, 1.0, 0.01),
            rivals,
        ).forecast(repetition(Given(judged.logs, rod)))
        for tolerances in ({}, {"joint_damping.damping": 0.1, "armature.inertia": 3.0})
    )
    assert sure is not None and unsure is not None
    assert unsure.least < sure.least


def test_motions_alike_do_not_tell_what_the_logs_leave_open_but_by_their_number() -> None:
    """A rival that is best in an eighth of the resamples needs a little over twice the logs, one in 0.45 many more."""

    def of(is_alike: bool, loss: float) -> Forecast:
        experiment = Experiment("any", {}, 1, "", "", list, is_alike=is_alike)
        return Forecast(experiment, (Separation("a", "b", loss, "base_pos_x", 1.0),), np.zeros(1))

    assert tells_apart(of(True, 40.0), 20.0, 0.125)
    assert tells_apart(of(True, 40.0), 20.0, 1e-22)
    assert not tells_apart(of(True, 31.0), 20.0, 0.2)
    assert not tells_apart(of(True, 40.0), 20.0, 0.45)
    assert tells_apart(of(False, 40.0), 20.0, 0.45)
    assert not tells_apart(of(False, 20.0), 20.0, 0.1)


def test_further_jumps_are_to_the_logged_distances_whose_plans_are_simulated() -> None:
    logs = tuple(SimpleNamespace(info=SimpleNamespace(extra={"target": {"x_m": x}})) for x in (0.55, 0.38, 0.38))
    given = Given(logs, SimpleNamespace(has_free_base=True))  # type: ignore[arg-type]
    jumps = other_jumps(given)
    assert given.is_jumps and jumps.number == 6 and jumps.is_alike
    assert jumps.words == "record 6 further jumps, to 38, 55 cm, with the front feet on blocks of 2 to 8 cm"
    assert jumps.collect[:2] == ("collect.targets=[[0.38,0.0],[0.55,0.0]]", "collect.jumps=6")


def test_a_log_without_pieces_counts_for_no_difference() -> None:
    """Few pieces are spread over the logs, so that a short one may have none; here one of three logs."""
    ages, noise = np.arange(1, 3), np.array([1.0, 2.0])
    own = SimpleNamespace(ages=ages, noise=noise)
    whitening = [np.tile(np.eye(4), (n, 1, 1)) for n in (2, 0, 1)]
    channels = [SimpleNamespace(name=name) for name in ("first", "second")]
    short = SimpleNamespace(pieces=[own] * 3, whitening=whitening, state=SimpleNamespace(channels=channels))
    errors = np.tile([1.0, 6.0, 1.0, 6.0], (3, 1))  # by age, then by channel
    assert largest_difference(errors, short) == ("second", pytest.approx(3.0))  # type: ignore[arg-type]


def test_plans_are_what_they_say(rod: Robot) -> None:
    given = Given(tuple(swing(seed) for seed in range(2)), rod)
    log = given.logs[0]
    (fast, _), (stiff, _) = other_speed(given, 2.0).plans, other_gains(given, 2.0).plans
    np.testing.assert_allclose(fast["cmd_pos/hinge"], log["cmd_pos/hinge"][::2], atol=1e-12)
    np.testing.assert_allclose(fast["cmd_vel/hinge"], 2 * log["cmd_vel/hinge"][::2], atol=1e-9)
    assert fast["joint_vel/hinge"][0] == pytest.approx(2 * log["joint_vel/hinge"][0])
    assert (stiff["cmd_kp/hinge"] == 2 * KP).all() and (stiff["cmd_kd/hinge"] == 2 * KD).all()
    np.testing.assert_array_equal(stiff["cmd_pos/hinge"], log["cmd_pos/hinge"])
    slow, middle, quick = sines(given, ("hinge",), (0.4,), 0.7).plans
    for plan in (slow, middle, quick):
        position, velocity = plan["cmd_pos/hinge"], plan["cmd_vel/hinge"]
        np.testing.assert_allclose(np.gradient(position, PERIOD_S)[1:-1], velocity[1:-1], atol=0.02)
        assert velocity[0] == 0 and plan["joint_vel/hinge"][0] == 0
        assert np.ptp(position) == pytest.approx(0.8, rel=0.1)


def test_candidates_stay_within_the_range_of_the_joint_and_can_be_read_back(rod: Robot) -> None:
    given = Given(tuple(swing(seed) for seed in range(2)), rod)
    found = candidates_for(given)
    assert {one.kind for one in found} == {"gains", "speed", "sines", "load"}
    assert [one.cost for one in found] == sorted(one.cost for one in found)
    for one in found:
        again = experiment_of(json.loads(json.dumps(one.settings)), given)
        assert (again.settings, again.words, again.short) == (one.settings, one.words, one.short)
        for plan, same in zip(one.plans, again.plans, strict=True):
            assert np.abs(plan["cmd_pos/hinge"]).max() < np.pi / 2
            assert all(np.array_equal(plan[name], same[name]) for name in plan.columns)
        thrice = plans_of({**one.settings, "repeats": 3}, given)
        assert [plan.name for plan in thrice] == [f"next_{k}" for k in range(3 * len(one.plans))]


def test_a_motion_beyond_a_joint_stop_or_the_motor_is_not_proposed(rod: Robot) -> None:
    plan = swing(0)
    motion = motion_of(plan, rod)
    assert is_possible(plan, motion, rod)
    assert not is_possible(plan, Motion(motion.qpos + 1.2, motion.qvel), rod)
    assert not is_possible(plan, Motion(motion.qpos, motion.qvel + 60.0), rod)
    assert not is_possible(plan, Motion(np.full_like(motion.qpos, np.nan), motion.qvel), rod)


def test_a_sine_that_the_motor_cannot_follow_is_made_smaller(weak_or_heavy: Forecaster) -> None:
    """At 6 Hz and 1 rad the rod asks for far more than its 30 N·m."""
    wild = sines(weak_or_heavy.given, ("hinge",), (1.0,), 6.0)
    assert weak_or_heavy.forecast(wild) is None
    found = weak_or_heavy.forecast_possible(wild)
    assert found is not None and found.experiment.numbers["frequency_hz"] == 6.0
    assert 0.1 < found.experiment.numbers["amplitude"][0] <= 0.6


def test_a_report_proposes_the_load_and_says_by_how_much(rod: Robot, tmp_path: Path) -> None:
    """End to end: either name fits these logs, so that the report asks for what separates them."""
    logs = [swing(seed, GAIN) for seed in range(4)]
    settings = Settings(effects=["torque_gain", "armature"], tolerances={}, folds=4)
    report = diagnose(logs, rod, settings).report
    assert report.verdict == "ambiguous", report.sentence
    proposal = report.next_experiment
    assert proposal is not None
    assert sorted(proposal["separates"]) == ["armature", "torque_gain"]
    assert proposal["settings"]["kind"] == "load"
    assert "kg fastened at the centre of mass of rod" in proposal["sentence"]
    assert "times the noise in" in proposal["sentence"]
    (expected,) = proposal["expected"]
    assert proposal["settings"].get("repeats", 1) * expected["loss"] > 60 > 10 * expected["loss_today"]
    json.dumps(report.to_json(), allow_nan=False)


def test_the_least_sure_number_is_sharpened_by_what_at_least_halves_its_spread(rod: Robot) -> None:
    """A damping that these logs know to four fifths of itself; a faster motion shows it more."""
    logs = [swing(seed, damping=0.05) for seed in range(3)]
    unsure, sure = (fit(rod, JointDamping, 0.05, spread) for spread in (0.04, 0.001))
    judged = JudgedLogs.of(logs, rod)
    asked, nothing = (
        sharpen(Forecaster(judged, Replayer(rod), Settings(tolerances={}), "joint_damping", of), lambda _: None)
        for of in (unsure, sure)
    )
    assert nothing is None
    assert asked is not None and "settings" in asked
    assert asked["sentence"].startswith(
        "The least sure number is damping of joint_damping, 0.05 ± 0.04 N·m·s/rad: record "
    )
    (expected,) = asked["expected"]
    assert expected["spread"] <= expected["spread_today"] / 2
    assert asked["separates"] == []


def loaded(gain: float, mass_kg: float) -> Log:
    """A log of the rod with a mass at its centre of mass, by plain MuJoCo, which states it."""
    model = mujoco.MjModel.from_xml_string(ROD.format(damping=0.0))
    model.body_mass[1] += mass_kg
    mujoco.mj_setConst(model, mujoco.MjData(model))
    plan = swing(0, gain)
    data, position, velocity = mujoco.MjData(model), np.empty(len(plan)), np.empty(len(plan))
    data.qvel[0] = plan["cmd_vel/hinge"][0]
    for row in range(len(plan)):
        position[row], velocity[row] = data.qpos[0], data.qvel[0]
        wanted, speed = plan["cmd_pos/hinge"][row], plan["cmd_vel/hinge"][row]
        for _ in range(round(PERIOD_S / model.opt.timestep)):
            data.ctrl[0] = gain * (KP * (wanted - data.qpos[0]) + KD * (speed - data.qvel[0]))
            mujoco.mj_step(model, data)
    info = LogInfo("rod", PERIOD_S, "plain MuJoCo", extra={"load": {"hinge": mass_kg}})
    return Log("loaded", dict(plan.columns) | {"joint_pos/hinge": position, "joint_vel/hinge": velocity}, info)


def test_a_replay_carries_the_load_that_a_log_states(rod: Robot) -> None:
    log = loaded(1.0, 0.5)
    silent = Log("silent", log.columns, LogInfo("rod", PERIOD_S, "plain MuJoCo"))
    with_it, without = (motion.qpos[:, 0] for motion in Replayer(rod).motions([Rollout(log), Rollout(silent)]))
    off = np.abs(with_it - log["joint_pos/hinge"]).max()
    assert off < 0.01
    assert np.abs(without - log["joint_pos/hinge"]).max() > 4 * off


def test_a_stated_load_is_no_force_from_outside(rod: Robot) -> None:
    """Inverse dynamics of the loaded motion leaves the rod just the torque that it would need by itself."""
    log = loaded(1.0, 0.5)
    states = States.of(log, rod)
    motion = instants_of(states, rod, 0.01)
    bare = inverse_dynamics(without_constraints(rod.model), motion)
    inside = slice(10, -10)  # the ends of a smoothed motion are less sure
    left = np.abs(without_loads(motion, log, rod).torque - bare)[inside]
    assert left.max() < 0.2 * np.abs(motion.torque - bare)[inside].max()


@pytest.mark.parametrize("mass", [-0.1, "heavy", 1e9])
def test_a_load_that_no_robot_carries_is_refused(mass: object) -> None:
    text = json.dumps(
        {"format_version": 2, "robot": "rod", "sample_period_s": 0.002, "source": "", "load": {"a": mass}}
    )
    with pytest.raises(InputError, match=r"load\.a"):
        LogInfo.from_json(text, "a log")
