"""Withheld cases: nothing but the motion tells them apart, and every effect moves it."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from leapgap import effects
from leapgap.effects.base import Commands, Effect
from leapgap.logs.log import Log
from leapgap.robot.model import Robot
from leapgap.simulation.open_loop import lift_out_of_ground
from leapgap.simulation.replay import Replayer
from leapgap.simulation.rollout import Rollout
from leapgap.validation.case import (
    CaseSetup,
    WithheldCase,
    effect_from_json,
    effect_to_json,
    proposed_logs,
    withhold,
    write_case,
)
from leapgap.validation.case_draw import Case, Half, draw_cases
from leapgap.validation.generator import Generator, Nuisance, NuisanceSizes
from leapgap.validation.off_table import (
    DRAG_AREA,
    FAMILIES,
    SLOSH_HZ,
    Backlash,
    Crosstalk,
    DeadBand,
    PacketLoss,
    SloshingPayload,
    Wind,
)
from stages.compose import compose_conf
from tests.conftest import standing


@pytest.fixture(scope="module")
def sizes() -> dict[str, dict[str, list[float]]]:
    return compose_conf()["withhold"]["sizes"]


@pytest.fixture(scope="module")
def halves() -> dict[str, Half]:
    names = sorted(FAMILIES)
    return {"a": Half(1, 20, 3, 6, 2, names[:6]), "b": Half(2, 20, 3, 7, 2, names[6:])}


def case_of(*acting: Effect) -> Case:
    return Case("reported", "single", acting, seed=5)


@pytest.fixture(scope="module")
def damped_case(references: list[Log], robot: Robot, world: CaseSetup) -> WithheldCase:
    return withhold(case_of(effects.effect("joint_damping", damping=0.8)), references, robot, world)


@pytest.fixture(scope="module")
def plain(references: list[Log], robot: Robot, world: CaseSetup) -> WithheldCase:
    return withhold(Case("reported", "none", (), seed=5), references, robot, world)


def test_metadata_and_commands_are_the_same_bytes_whatever_acts(
    damped_case: WithheldCase,
    plain: WithheldCase,
    references: list[Log],
    robot: Robot,
    world: CaseSetup,
    tmp_path: Path,
) -> None:
    windy = withhold(case_of(Wind(speed_m_s=9.0)), references, robot, world)
    late = withhold(case_of(effects.effect("sample_period", scale=1.1)), references, robot, world)
    told = []
    for i, made in enumerate((damped_case, plain, windy, late)):
        write_case(made, tmp_path / f"logs{i}", tmp_path / f"proof{i}")
        paths = sorted((tmp_path / f"logs{i}").iterdir())
        tables = [pq.read_table(path) for path in paths]
        commands = [
            [t[c].to_numpy().tobytes() for c in t.column_names if c.startswith(("cmd_", "time"))] for t in tables
        ]
        told.append(
            [[p.name for p in paths], [t.schema.metadata for t in tables], [t.schema for t in tables], commands]
        )
    assert all(one == told[0] for one in told[1:])


def test_the_same_case_is_the_same_bytes(
    damped_case: WithheldCase, references: list[Log], robot: Robot, world: CaseSetup
) -> None:
    again = withhold(case_of(effects.effect("joint_damping", damping=0.8)), references, robot, world)
    assert again.truth == damped_case.truth
    for one, other in zip(again.logs + again.proof, damped_case.logs + damped_case.proof, strict=True):
        assert all(np.array_equal(one[c], other[c]) for c in other.columns)


def test_truth_says_what_acts_and_how_much_it_shows(damped_case: WithheldCase, plain: WithheldCase) -> None:
    assert damped_case.truth["effects"] == [
        {"name": "joint_damping", "location": "all", "parameters": {"damping": 0.8}}
    ]
    assert damped_case.truth["detectable"]
    assert damped_case.truth["change"] > 2 * damped_case.truth["noise_floor"]
    shares = [place["share"] for place in damped_case.truth["where"]]
    assert shares == sorted(shares, reverse=True)
    assert sum(shares) == pytest.approx(1, abs=0.05)
    assert not plain.truth["detectable"]
    assert plain.truth["change"] == 0


def test_a_proposed_experiment_is_made_by_the_robot_of_the_case(
    damped_case: WithheldCase, robot: Robot, world: CaseSetup
) -> None:
    """Commands with 1.4 times the gains; the same effect and nuisances act, so that damped joints lag as before."""
    settled = replace(world, course=replace(world.course, after_landing_s=0.0))
    logs = list(damped_case.logs)
    made = proposed_logs(damped_case.truth, {"kind": "gains", "factor": 1.4}, logs, robot, settled)
    assert [log.name for log in made] == ["next_0", "next_1"]
    for log, new in zip(logs, made, strict=True):
        rows = len(new)
        np.testing.assert_allclose(new["cmd_kp/FR_calf"], 1.4 * log["cmd_kp/FR_calf"][:rows])
        np.testing.assert_array_equal(new["cmd_pos/FR_calf"], log["cmd_pos/FR_calf"][:rows])
        assert np.isfinite(new["joint_pos/FR_calf"]).all()
    again = proposed_logs(damped_case.truth, {"kind": "gains", "factor": 1.4}, logs, robot, settled)
    assert all(np.array_equal(a["joint_pos/FR_calf"], b["joint_pos/FR_calf"]) for a, b in zip(made, again, strict=True))


def test_nuisances_alone_stay_near_the_noise_floor(plain: WithheldCase, damped_case: WithheldCase) -> None:
    assert plain.truth["gap_nominal"] < 3 * plain.truth["noise_floor"]
    assert damped_case.truth["gap_nominal"] > plain.truth["gap_nominal"]


def test_cases_cover_every_effect_and_families_are_split(
    halves: dict[str, Half], sizes: dict[str, dict[str, list[float]]], robot: Robot
) -> None:
    cases = draw_cases(halves, sizes, ["com_offset"], robot)
    assert len(cases) == 63
    for half in halves:
        own = [c for c in cases if c.half == half]
        assert {c.effects[0].name for c in own if c.kind == "single"} == set(effects.by_default())
        assert {c.effects[0].name for c in own if c.kind == "nameless"} == set(halves[half].families)
        assert all(c.effects[0].name != c.effects[1].name for c in own if c.kind == "pair")
    assert [c.kind for c in cases] != sorted(c.kind for c in cases)
    for case in cases:
        for effect in case.effects:
            for p in effect.parameters(robot, effect.location):
                assert p.lower <= getattr(effect, p.name) <= p.upper
                assert getattr(effect, p.name) != p.nominal
            assert effect_from_json(effect_to_json(effect)) == effect


def test_triples_are_three_different_effects_and_change_no_other_case(
    halves: dict[str, Half], sizes: dict[str, dict[str, list[float]]], robot: Robot
) -> None:
    more = {name: replace(half, triple=4) for name, half in halves.items()}
    cases, before = draw_cases(more, sizes, [], robot), draw_cases(halves, sizes, [], robot)
    triples = [case for case in cases if case.kind == "triple"]
    assert len(triples) == 4 * len(halves)
    assert all(len({effect.name for effect in case.effects}) == 3 for case in triples)
    first = min(halves)
    drawn = {case.effects for case in cases if case.half == first and case.kind != "triple"}
    assert drawn == {case.effects for case in before if case.half == first}


def test_no_off_table_effect_is_known_to_the_diagnosis() -> None:
    assert len(FAMILIES) >= 8
    assert not set(FAMILIES) & set(effects.known())


def largest(sizes: dict[str, dict[str, list[float]]], name: str) -> Effect:
    return FAMILIES[name](**{key: value[1] for key, value in sizes[name].items()})


@pytest.mark.parametrize("name", sorted(FAMILIES))
def test_every_off_table_effect_changes_the_motion(
    name: str, sizes: dict[str, dict[str, list[float]]], references: list[Log], robot: Robot, plain: WithheldCase
) -> None:
    generator = Generator(robot, terrain_slots=1, step_s=0.0005)
    jump = plain.logs[0].first_rows(1100)
    trial = Rollout(jump, (largest(sizes, name),))
    assert lift_out_of_ground(trial, generator.first_state(trial), generator).shape == (
        robot.model.nq + robot.model.nv,
    )
    on, off = generator.motions([trial, Rollout(jump)])
    assert np.abs(on.qpos - off.qpos).max() > 0.005


@pytest.mark.parametrize("name", sorted(FAMILIES))
def test_an_off_table_effect_at_nothing_changes_nothing(name: str, robot: Robot) -> None:
    if name == "backlash":
        pytest.skip("gears without play are still elastic")
    generator = Generator(robot, step_s=0.0005)
    jump = standing(robot, rows=60)
    on, off = generator.motions([Rollout(jump, (FAMILIES[name](),)), Rollout(jump)])
    assert np.abs(on.qpos - off.qpos).max() < 1e-12


def test_generator_is_another_simulation_that_agrees_to_first_order(robot: Robot, plain: WithheldCase) -> None:
    jump = plain.logs[0].first_rows(700)
    (fine,) = Generator(robot, terrain_slots=1).motions([Rollout(jump)])
    (coarse,) = Replayer(robot).motions([Rollout(jump)])
    apart = np.abs(fine.qpos - coarse.qpos).max()
    assert 1e-6 < apart < 0.02


def test_generator_with_other_steps_is_the_generator_that_was_made_with_them(robot: Robot) -> None:
    jump = standing(robot, rows=60)
    rough = Generator(robot, terrain_slots=2, step_s=0.001)
    other, fresh = rough.with_steps(0.00025), Generator(robot, terrain_slots=2, step_s=0.00025)
    assert isinstance(other, Generator)
    assert other.substeps(jump) == 4
    assert rough.substeps(jump) == 1
    (one,), (two,), (three,) = (of.motions([Rollout(jump)]) for of in (other, fresh, rough))
    assert np.array_equal(one.qpos, two.qpos)
    assert not np.array_equal(one.qpos, three.qpos)


def test_nuisances_scale_masses_by_what_they_say(robot: Robot) -> None:
    model = Generator(robot).model(Rollout(standing(robot), (Nuisance(seed=3, sizes=NuisanceSizes(mass=0.01)),)))
    ratio = model.body_mass[1 : robot.model.nbody] / robot.model.body_mass[1:]
    assert 0.003 < np.std(ratio) < 0.03
    assert np.array_equal(
        model.body_mass,
        Generator(robot).model(Rollout(standing(robot), (Nuisance(seed=3, sizes=NuisanceSizes(mass=0.01)),))).body_mass,
    )


def flying(robot: Robot, rows: int = 200) -> Log:
    """Free fall, joints held: what acts on the trunk can be read off its acceleration."""
    return standing(robot, rows=rows, height_m=5.0)


@pytest.mark.parametrize("rate_hz", [1000, 500, 100])
def test_commands_get_lost_for_12_ms_at_a_time(robot: Robot, rate_hz: int) -> None:
    rows = 2 * rate_hz
    sent = np.arange(rows * 1.0)[:, None]
    came = PacketLoss(share=0.3).change_commands(Commands(sent, sent, sent), 1 / rate_hz, robot).torque[:, 0]
    lost = np.flatnonzero(came != sent[:, 0])
    lengths = np.diff(np.flatnonzero(np.diff(np.concatenate([[False], came != sent[:, 0], [False]]).astype(int))))[::2]
    assert 0.15 < len(lost) / rows < 0.45
    burst = max(1, round(0.012 * rate_hz))
    assert (lengths[1:-1] % burst == 0).all()
    assert lengths[1:-1].min() == burst  # the first command always comes, and the log cuts the last burst


def test_wind_pushes_with_its_drag(robot: Robot) -> None:
    on, off = Generator(robot).motions(
        [Rollout(flying(robot, 100), (Wind(speed_m_s=10.0),)), Rollout(flying(robot, 100))]
    )
    gained = robot.total_mass * (on.qvel[-1, 0] - off.qvel[-1, 0])
    assert gained == pytest.approx(DRAG_AREA * 10.0**2 * 0.099, rel=0.1)


def test_sloshing_mass_keeps_the_total_and_swings_at_its_frequency(robot: Robot) -> None:
    effect = SloshingPayload(mass_kg=1.0)
    model = Generator(robot).model(Rollout(flying(robot), (effect,)))
    assert model.body_subtreemass[1] == pytest.approx(robot.total_mass)
    omega = 2 * np.pi * SLOSH_HZ
    assert model.jnt_stiffness[model.joint(effect.name).id] == pytest.approx(1.0 * omega**2)


def test_a_joint_gets_a_share_of_the_torque_of_the_next_motor_of_its_leg(robot: Robot) -> None:
    """In the air, where a calf is told 4 N·m: the thigh of that leg, and no other joint, gets a quarter of them."""
    pushed = flying(robot, 20)
    columns = dict(pushed.columns) | {"cmd_tau/RR_calf": np.full(20, 4.0)}
    columns |= {name: np.zeros(20) for name in columns if name.startswith(("cmd_kp", "cmd_kd"))}
    generator, told = Generator(robot, step_s=0.001), {"cmd_tau/RR_thigh": np.full(20, 1.0)}
    log, thigh = Log("air", columns, pushed.info), Log("thigh", columns | told, pushed.info)
    leaking, same, off = generator.motions(
        [Rollout(log, (Crosstalk("thigh", share=0.25),)), Rollout(thigh), Rollout(log)]
    )
    moved = np.abs(same.qvel - off.qvel).max()
    assert moved > 0.1
    assert np.abs(leaking.qvel - same.qvel).max() < 0.02 * moved


def test_a_dead_band_takes_what_it_says_from_a_torque_and_all_of_a_small_one(robot: Robot) -> None:
    """In the air: told 4 and 0.5 N·m with a band of 1, the calves move as if told 3 and nothing."""
    air = flying(robot, 20)
    free = dict(air.columns) | {name: np.zeros(20) for name in air.columns if name.startswith(("cmd_kp", "cmd_kd"))}

    def told(rear: float, front: float) -> Log:
        both = {"cmd_tau/RR_calf": np.full(20, rear), "cmd_tau/FR_calf": np.full(20, front)}
        return Log("air", free | both, air.info)

    trials = [Rollout(told(4.0, -0.5), (DeadBand("calf", torque_nm=1.0),)), Rollout(told(3.0, 0.0))]
    cut, same, full = Generator(robot, step_s=0.001).motions([*trials, Rollout(told(4.0, -0.5))])
    assert np.abs(full.qvel - same.qvel).max() > 0.1
    assert np.abs(cut.qvel - same.qvel).max() < 1e-6


def test_backlash_holds_the_link_within_its_play(robot: Robot) -> None:
    jump = standing(robot, rows=400)
    narrow, wide = Generator(robot).motions(
        [Rollout(jump, (Backlash(play_rad=0.005),)), Rollout(jump, (Backlash(play_rad=0.05),))]
    )
    spread = [
        np.abs(m.qpos[100:, robot.joint_qpos] - m.qpos[100:, robot.joint_qpos].mean(axis=0)).max()
        for m in (narrow, wide)
    ]
    assert spread[1] > spread[0]
