"""Logs whose rows are not what they claim: what the generator writes, against physics and against the even log."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from leapgap import effects
from leapgap.errors import InputError
from leapgap.logs.log import Log
from leapgap.robot.model import Robot
from leapgap.simulation.rollout import Rollout
from leapgap.validation.case import CaseSetup, WithheldCase, further_jumps, withhold
from leapgap.validation.case_draw import Case, FurtherCounts, FurtherKinds, Half, draw_cases
from leapgap.validation.generator import OTHERS, Generator, Nuisance, physics_of
from leapgap.validation.uneven_rows import FAMILIES, ClockFamily, UnevenRows
from stages.compose import compose_conf
from tests.conftest import standing

GRAVITY = 9.81
ROWS, LIMBS = 4000, 4


def clock(name: str, **sizes: float) -> ClockFamily:
    return ClockFamily(name, sizes)


def case_of(clock: ClockFamily | None, *acting: effects.Effect) -> Case:
    return Case("reported", "none" if clock is None else "uneven", acting, seed=5, clock=clock)


@pytest.fixture(scope="module")
def even(references: list[Log], robot: Robot, world: CaseSetup) -> WithheldCase:
    return withhold(case_of(None), references, robot, world)


@pytest.fixture(scope="module")
def lost(references: list[Log], robot: Robot, world: CaseSetup) -> WithheldCase:
    return withhold(case_of(clock("lost_rows", share=0.3)), references, robot, world)


@pytest.fixture(scope="module")
def stale(references: list[Log], robot: Robot, world: CaseSetup) -> WithheldCase:
    return withhold(case_of(clock("stale_samples", share=0.3)), references, robot, world)


@pytest.fixture(scope="module")
def late(references: list[Log], robot: Robot, world: CaseSetup) -> WithheldCase:
    damping = effects.effect("joint_damping", damping=0.8)
    return withhold(case_of(clock("late_writer", share=0.6), damping), references, robot, world)


def test_a_robot_falls_with_g_on_the_true_instants_of_its_rows(robot: Robot) -> None:
    lengths = np.random.default_rng(1).choice([0.0, 0.3, 1.0, 2.0, 7.3], 200)
    log = standing(robot, rows=200, height_m=30.0)
    (motion,) = Generator(robot).motions([Rollout(log, (UnevenRows(lengths=lengths),))])
    time = 0.001 * np.concatenate([[0.0], np.cumsum(lengths[:-1])])
    fall = motion.qpos[0, 2] + motion.qvel[0, 2] * time - GRAVITY / 2 * time**2
    assert np.abs(motion.qpos[:, 2] - fall).max() < 3e-3  # legs that settle move the trunk a little
    claimed = 0.001 * np.arange(200)
    assert np.abs(motion.qpos[:, 2] - motion.qpos[0, 2] + GRAVITY / 2 * claimed**2).max() > 0.1


def test_rows_are_states_of_plain_mujoco_at_their_instants(robot: Robot) -> None:
    lengths = np.array([2.0, 0.0, 1.0, 3.0, 0.0, 0.0, 5.0, 1.0, 4.0, 1.0])
    log = standing(robot, rows=10)
    generator, nuisance = Generator(robot, step_s=0.00025), Nuisance(seed=3)
    (motion,) = generator.motions([Rollout(log, (nuisance, UnevenRows(lengths=lengths)))])
    model = generator.model(Rollout(log, (nuisance,)))
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = motion.qpos[0], motion.qvel[0]
    wanted = log.per_joint("cmd_kp") * log.per_joint("cmd_pos") + log.per_joint("cmd_kd") * log.per_joint("cmd_vel")
    for row in range(1, 10):
        data.ctrl[robot.joint_actuators] = (log.per_joint("cmd_tau") + wanted)[row - 1]
        for _ in range(round(4 * lengths[row - 1])):
            mujoco.mj_step(model, data)
        assert np.allclose(motion.qpos[row], data.qpos, atol=1e-12)
        assert np.allclose(motion.qvel[row], data.qvel, atol=1e-9)


def test_a_log_of_lost_rows_is_the_even_log_without_them(even: WithheldCase, lost: WithheldCase) -> None:
    for whole, left in zip(even.logs, lost.logs, strict=True):
        kept = [int(np.flatnonzero(whole["base_pos_x"] == x)[0]) for x in left["base_pos_x"]]
        assert kept[0] == 0 and (np.diff(kept) > 0).all()
        assert 0.6 < len(left) / len(whole) < 0.8
        for name in left.columns:
            expected = whole.time[: len(left)] if name == "time" else whole[name][kept]
            assert np.array_equal(left[name], expected), name
        # A named interval begins at the row that it began at, by the time that the log claims.
        before, after = whole.info.segments[1], left.info.segments[1]
        assert before.name == after.name
        assert abs(kept[round(after.begin_s / 0.001)] - round(before.begin_s / 0.001)) <= 3
    assert lost.truth["effects"][0]["parameters"]["scale"] == pytest.approx(1 / 0.7, rel=0.05)


def test_stale_rows_repeat_each_limb_and_the_base_on_their_own(
    even: WithheldCase, stale: WithheldCase, robot: Robot
) -> None:
    for whole, old in zip(even.logs, stale.logs, strict=True):
        repeats = {}
        for name in whole.columns:
            if not name.startswith(("joint_", "base_")):
                assert np.array_equal(old[name], whole[name])
                continue
            again = np.append(False, np.diff(old[name]) == 0)
            fresh = np.maximum.accumulate(np.where(again, 0, np.arange(len(whole))))
            assert np.array_equal(old[name], whole[name][fresh]), name
            message = robot.limb_of(name.split("/")[1]) if name.startswith("joint_") else "base"
            assert (repeats.setdefault(message, again) == again).all()
        assert all(0.25 < again.mean() < 0.35 for again in repeats.values())
        shares = [(one & other).mean() for one in repeats.values() for other in repeats.values() if one is not other]
        assert len(repeats) == 5 and max(shares) < 0.15


def test_the_truth_tells_the_clock_from_the_effect_beside_it(late: WithheldCase) -> None:
    clock, damping = late.truth["effects"]
    assert clock["name"] == "sample_period" and damping["name"] == "joint_damping"
    lasted = [values[0]["scale"] for values in late.truth["per_log"].values()]
    expected = 1 - 0.6 + 0.6 * (0.45 * 2 + 0.2 * 3)
    assert np.allclose(lasted, expected, rtol=0.06)
    assert clock["parameters"]["scale"] == pytest.approx(np.median(lasted[: len(late.logs)]))
    assert late.truth["clock"] == {"family": "late_writer", "sizes": {"share": 0.6}}
    floor, (by_clock, by_damping) = late.truth["noise_floor"], late.truth["changes"]
    assert by_clock > 10 * floor and by_damping > 2 * floor and late.truth["detectable"]


def test_a_stale_log_changes_the_motion_by_less_than_one_period_does(stale: WithheldCase) -> None:
    assert 0 < stale.truth["change"] < 2 * stale.truth["noise_floor"]
    assert stale.truth["effects"][0]["parameters"] == {"scale": 1.0}


def test_further_jumps_of_an_uneven_case_have_its_clock(
    late: WithheldCase, references: list[Log], robot: Robot, world: CaseSetup
) -> None:
    (jump,) = further_jumps(late.truth, references, (0.02, 0.02), robot, world)
    moved, speed = np.diff(jump["joint_pos/FR_calf"]), jump["joint_vel/FR_calf"]
    period = float((moved * speed[:-1]).sum() / (speed[:-1] ** 2).sum())
    assert period == pytest.approx(0.001 * late.truth["effects"][0]["parameters"]["scale"], rel=0.15)


def drawn(family: ClockFamily, seed: int = 1):
    return family.draw(ROWS, LIMBS, np.random.default_rng(seed))


def test_families_are_what_they_are_named_after() -> None:
    held = drawn(clock("late_writer", share=0.5)).held
    assert set(held) == {0.0, 1.0, 2.0, 3.0} and np.mean(held == 1) == pytest.approx(0.5, abs=0.03)
    held = drawn(clock("stalls", per_1000=10.0)).held
    assert set(held[held < 4]) == {1.0} and held.max() <= 12 and 20 < (held > 1).sum() < 60
    held = drawn(clock("drift", size=0.2)).held
    assert np.abs(np.diff(held)).max() < 0.001 and 0.79 < held.min() < held.max() < 1.21 and np.ptp(held) > 0.1
    for length, true in ((0.77, 0.75), (1.02, 1.25), (1.5, 1.5)):
        assert set(drawn(clock("other_period", length=length)).held) == {true}
    written = drawn(clock("lost_rows", share=0.2)).written
    assert written[0] and written.mean() == pytest.approx(0.8, abs=0.03)
    every = drawn(clock("late_messages", share=0.5, per_1000=10.0))
    assert every.stale.mean() == pytest.approx(0.25, abs=0.02) and (every.held >= 4).any() and (every.held == 0).any()


def test_rows_of_one_instant_and_lost_rows_show_the_samples_of_written_rows() -> None:
    both = replace(drawn(clock("lost_rows", share=0.4)), stale=drawn(clock("stale_samples", share=0.4), 2).stale)
    assert both.instants[0] == 0 and len(both.instants) == both.written.sum() == len(both.shown)
    assert (both.shown <= np.arange(len(both.shown))[:, None]).all()
    assert np.array_equal(both.instants, np.flatnonzero(both.written))


def test_an_unknown_family_or_physics_is_told() -> None:
    with pytest.raises(InputError, match="clock family leap_seconds"):
        clock("leap_seconds")
    with pytest.raises(InputError, match="physics aether"):
        physics_of("aether")


@pytest.fixture(scope="module")
def section() -> dict:
    return compose_conf()["withhold"]


HALVES = {"reported": Half(7, 3, 1, 1, 1, ["wind"])}


def draw(section: dict, robot: Robot, *numbers: int, shares: dict | None = None) -> list[Case]:
    """Cases with so many of uneven rows, of a third physics and of too high models."""
    further = FurtherKinds({"reported": FurtherCounts(*numbers)}, section["clocks"], shares or section["too_high"])
    return draw_cases(HALVES, section["sizes"], section["signed"], robot, further)


def test_further_kinds_leave_the_ordinary_cases_of_a_seed_as_they_are(section: dict, robot: Robot) -> None:
    plain = draw_cases(HALVES, section["sizes"], section["signed"], robot)
    cases = draw(section, robot, 14, 6, 6)
    assert cases[: len(plain)] == plain and len(cases) == len(plain) + 26
    assert all(case in cases for case in draw(section, robot, 7, 0, 0))


def test_further_kinds_cover_families_physics_and_effects(section: dict, robot: Robot) -> None:
    cases = draw(section, robot, 14, 6, 6)
    uneven = [case for case in cases if case.kind == "uneven"]
    assert sorted(case.clock.name for case in uneven if not case.effects) == sorted(FAMILIES)
    assert sorted(case.clock.name for case in uneven if case.effects) == sorted(FAMILIES)
    assert not any(effect.differs_per_log for case in uneven for effect in case.effects)
    third = [case for case in cases if case.kind == "third"]
    assert sorted(case.physics.name for case in third if not case.effects) == sorted(OTHERS)
    assert sorted(case.physics.name for case in third if case.effects) == sorted(OTHERS)
    too_high = [effect for case in cases if case.kind == "too_high" for effect in case.effects]
    assert {effect.name for effect in too_high} == {"armature", "joint_damping", "joint_friction"}


def test_a_robot_of_a_too_high_model_has_the_share_that_was_drawn(section: dict, robot: Robot) -> None:
    shares = {"armature": {"inertia": [0.25, 0.25]}, "joint_friction": {"torque_nm": [0.0, 0.0]}}
    dofs = robot.joint_dofs
    for case in draw(section, robot, 0, 0, 4, shares=shares)[len(draw(section, robot, 0, 0, 0)) :]:
        (effect,) = case.effects
        model = Generator(robot).model(Rollout(standing(robot), (effect,)))
        table = {"armature": "dof_armature", "joint_friction": "dof_frictionloss"}[effect.name]
        ratio = getattr(model, table)[dofs] / getattr(robot.model, table)[dofs]
        assert set(np.round(ratio, 3)) <= {1.0, 0.25 if effect.name == "armature" else 0.0}
        assert (ratio < 1).any()


@pytest.mark.parametrize("name", sorted(OTHERS))
def test_a_third_physics_moves_the_robot_otherwise_and_to_first_order_alike(
    name: str, references: list[Log], robot: Robot, world: CaseSetup, even: WithheldCase
) -> None:
    third = withhold(Case("reported", "third", (), seed=5, physics=OTHERS[name]), references, robot, world)
    assert third.truth["physics"] == name and not third.truth["detectable"]
    one, other = third.logs[0], even.logs[0]
    apart = np.abs(one.stack(["base_pos_x", "base_pos_z"]) - other.stack(["base_pos_x", "base_pos_z"]))[:500].max()
    assert 1e-4 < apart < 0.02
    model = Generator(robot).model(Rollout(standing(robot), (Nuisance(seed=1, physics=OTHERS[name]),)))
    usual = Generator(robot).model(Rollout(standing(robot), (Nuisance(seed=1),)))
    assert model.opt.integrator not in (usual.opt.integrator, robot.model.opt.integrator)


def test_stiff_feet_sink_less(robot: Robot) -> None:
    log = standing(robot, rows=400)
    sunk = []
    for physics in (OTHERS["stiff"], None):
        nuisance = Nuisance(seed=1) if physics is None else Nuisance(seed=1, physics=physics)
        generator = Generator(robot, step_s=0.000125)
        (motion,) = generator.motions([Rollout(log, (nuisance,))])
        end = Rollout(log, (nuisance,), first_state=motion.last_state)
        sunk.append(generator.foot_depths(end).mean())
    # In rest a contact yields as the square of its time constant, 0.3² here, and by its impedance.
    assert 0 < sunk[0] < 0.2 * sunk[1]
