"""Cases of the owners' family: a robot with up to three errors, its logs and model file, and the truth."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from leapgap.logs.log import Log, LogInfo, write_log
from leapgap.robot.mjcf import OWN_MODEL
from leapgap.runtime.atomic_io import sha256, write_text
from leapgap.validation.outcome import DETECTABLE_FLOORS
from leapgap.validation.owners.errors import OF_ROBOT, Error, Situation
from leapgap.validation.owners.plant import OwnersDrive, OwnersPlant, Run, build
from leapgap.validation.owners.robots import BASE_NOISE, REST_S, ROBOTS, OwnersRobot

LOGS, PROOFS, MEASURED = 4, 2, 2
"""Logs that are diagnosed, those that stay with the truth, and those that the change by the errors is measured on."""
NUMBERS = (1, 2, 1, 3, 1, 2, 1, 0, 2, 1)  # how many errors ten cases have, in shuffled order
KINDS = ("none", "single", "pair", "triple")


@dataclass(frozen=True)
class OwnersHalf:
    """Cases of one half of the check."""

    seed: int
    cases: int


@dataclass(frozen=True)
class OwnersCase:
    """One case: what is wrong by name, and the seed that sizes, places, motions and noise are drawn from."""

    half: str
    robot: str
    errors: tuple[str, ...]
    seed: int


def draw_owners(half: str, of_half: OwnersHalf) -> list[OwnersCase]:
    """The cases of a half, in shuffled order: robots in turn, and the errors of each from a shuffled deck."""
    rng, cases = np.random.default_rng(of_half.seed), []
    decks: dict[str, list[str]] = {name: [] for name in ROBOTS}
    for number, wanted in enumerate(rng.permutation(np.resize(NUMBERS, of_half.cases))):
        name, drawn = tuple(ROBOTS)[number % len(ROBOTS)], list[str]()
        while len(drawn) < wanted:
            deck = decks[name]
            if not deck:
                deck += rng.permutation([error.__name__ for error in OF_ROBOT[name]]).tolist()
            if (error := deck.pop()) not in drawn:
                drawn.append(error)
        cases.append(OwnersCase(half, name, tuple(drawn), int(rng.integers(2**31))))
    return [cases[i] for i in rng.permutation(len(cases))]


def write_owners_case(case: OwnersCase, models: Path, logs: Path, proof: Path) -> dict[str, Any]:
    """Write logs and model file of a case, and its proof logs; the truth."""
    robot, rng = ROBOTS[case.robot], np.random.default_rng(case.seed)
    salt, file = rng.bytes(16).hex(), models / f"{robot.model}.xml"
    plans_rng, size_rng, wear_rng, noise_rng = rng.spawn(4)
    spec = mujoco.MjSpec.from_file(str(file))
    limit = np.array([max(np.abs(a.ctrlrange).max(), np.abs(a.forcerange).max()) for a in spec.actuators])
    drive = OwnersDrive(np.array(robot.kp), np.array(robot.kd), limit)
    nominal, wear = build(file, drive), int(wear_rng.integers(2**31))
    plans = [Plan.draw(robot, nominal, plans_rng) for _ in range(LOGS + PROOFS)]
    expected = [plan.run(nominal, robot) for plan in plans[:MEASURED]]
    errors = draw_errors(case, robot, nominal, expected[0], limit, size_rng)

    def made(acting: Sequence[Error], number: int) -> list[Run]:
        changed = replace(drive, **{key: value for one in acting for key, value in one.drive.items()})
        specs, models = [e.spec for e in acting if e.spec], [e.model for e in acting if e.model]
        plant = build(file, changed, np.random.default_rng(wear), specs, models)
        held = 1 if any(one.held_rows > 1 for one in acting) else robot.policy_rows
        return [plan.run(plant, robot, held) for plan in plans[:number]]

    runs = made(errors, len(plans))
    names = [f"log_{i}" for i in range(LOGS)] + [f"proof_{i}" for i in range(PROOFS)]
    for name, plan, run in zip(names, plans, runs, strict=True):
        log = logged(name, plan, run, robot, errors, nominal.names, noise_rng)
        write_log(log, (logs if name.startswith("log") else proof) / f"{name}.parquet")
    write_text(logs / OWN_MODEL, model_file(spec, errors))
    floor = difference(made((), MEASURED), expected, robot, with_noise=True)
    effects = [one for one in errors if not one.is_fact]
    filed = {e.name: Error(e.name, drive={"limit": e.file_limit}) for e in effects if e.file_limit is not None}
    change = difference(made(tuple(filed.values()), MEASURED), runs, robot) if effects else 0.0

    def without(e: Error) -> list[Error]:
        return [filed[e.name] if o is e else o for o in errors if o is not e or e.name in filed]

    changes = [difference(made(without(e), MEASURED), runs, robot) for e in effects]
    return {
        "salt": salt,
        "half": case.half,
        "kind": KINDS[len(effects)],
        "seed": case.seed,
        "robot": "owners",
        "owners_robot": case.robot,
        "effects": [
            {"name": e.name, "location": e.location, "parameters": e.parameters, "same": list(e.same), "told": e.told}
            for e in effects
        ],
        "facts": {e.name: {"told": e.told, **e.parameters} for e in errors if e.is_fact},
        "per_log": {name: [e.parameters for e in effects] for name in names},
        "noise_floor": floor,
        "change": change,
        "changes": changes,
        "detectable": change >= DETECTABLE_FLOORS * floor,
        "where": [],
        "logs": {f"{name}.parquet": sha256(logs / f"{name}.parquet") for name in names[:LOGS]},
        "proof": {f"{name}.parquet": sha256(proof / f"{name}.parquet") for name in names[LOGS:]},
        "model": {OWN_MODEL: sha256(logs / OWN_MODEL)},
    }


def draw_errors(
    case: OwnersCase, robot: OwnersRobot, nominal: OwnersPlant, run: Run, limit: np.ndarray, rng: np.random.Generator
) -> list[Error]:
    """The errors of a case with their sizes and places."""
    data, whole = mujoco.MjData(nominal.model), np.zeros((nominal.model.nv, nominal.model.nv))
    data.qpos[:] = nominal.model.key_qpos[0]
    mujoco.mj_forward(nominal.model, data)
    mujoco.mj_fullM(nominal.model, data, whole)
    situation = Situation(robot, nominal.names, limit, whole.diagonal()[nominal.dofs], run, nominal.dofs, rng)
    kinds = {kind.__name__: kind for kind in OF_ROBOT[case.robot]}
    return [kinds[name](situation) for name in case.errors]


@dataclass(frozen=True)
class Plan:
    """Set points of one log, from the rest before it on."""

    smooth: np.ndarray  # set points before the controller holds them, (rest and rows, joints), rad
    rest_rows: int

    @staticmethod
    def draw(robot: OwnersRobot, plant: OwnersPlant, rng: np.random.Generator) -> "Plan":
        """A motion of the robot from the pose of its keyframe."""
        rest = round(REST_S / robot.period_s)
        time = np.arange(round(robot.length_s / robot.period_s) + 1) * robot.period_s
        pose = plant.model.key_qpos[0][plant.model.jnt_qposadr[plant.joints]]
        moving = robot.set_points(time, pose, rng)
        return Plan(np.concatenate([np.repeat(moving[:1], rest, axis=0), moving]), rest)

    def commands(self, robot: OwnersRobot, held_rows: int) -> tuple[np.ndarray, np.ndarray]:
        """Set points of positions and velocities, each held for so many rows, (rest and rows, joints)."""
        speed = np.gradient(self.smooth, robot.period_s, axis=0) if robot.sends_velocity else np.zeros_like(self.smooth)
        rows = np.arange(len(self.smooth)) - self.rest_rows
        rows = np.maximum(0, rows // held_rows * held_rows + self.rest_rows)
        return self.smooth[rows], speed[rows]

    def run(self, plant: OwnersPlant, robot: OwnersRobot, held_rows: int | None = None) -> Run:
        """The motion of a robot under these set points."""
        position, velocity = self.commands(robot, held_rows or robot.policy_rows)
        return plant.run(position, velocity, robot.period_s, robot.step_s, self.rest_rows)


def logged(
    name: str, plan: Plan, run: Run, robot: OwnersRobot, errors: Sequence[Error], joints: Sequence[str], rng: Any
) -> Log:
    """The log of a motion, with noise, resolution and the errors of the log."""
    rows = len(run.qpos)
    shown, speed = run.shown, run.speed
    for error in errors:
        speed = error.velocity(speed, robot.period_s) if error.velocity else speed
    held = max([robot.policy_rows, *(error.held_rows for error in errors)])
    sent, sent_speed = (one[plan.rest_rows :] for one in plan.commands(robot, held))
    shown = rounded(shown + robot.noise[0] * rng.standard_normal(shown.shape), robot.ticks[0])
    speed = rounded(speed + robot.noise[1] * rng.standard_normal(speed.shape), robot.ticks[1])
    columns = {"time": np.arange(rows) * robot.period_s}
    for j, joint in enumerate(joints):
        columns |= {f"joint_pos/{joint}": shown[:, j], f"cmd_pos/{joint}": sent[:, j]}
        columns |= {f"joint_vel/{joint}": speed[:, j]} if robot.logs_velocity else {}
        columns |= {f"cmd_vel/{joint}": sent_speed[:, j], f"cmd_tau/{joint}": np.zeros(rows)}
        columns |= {f"cmd_kp/{joint}": np.full(rows, robot.kp[j]), f"cmd_kd/{joint}": np.full(rows, robot.kd[j])}
    if robot.walks:
        # Columns of a floating base, with noise
        rows = len(run.qpos)
        noise = {part: size * rng.standard_normal((rows, 3)) for part, size in BASE_NOISE.items()}
        attitude = run.qpos[:, 3:7].copy()
        for row in range(rows):
            mujoco.mju_quatIntegrate(attitude[row], noise["base_quat"][row], 1.0)
        found = {f"base_quat_{axis}": attitude[:, i] for i, axis in enumerate("wxyz")}
        parts = {"base_pos": run.qpos[:, :3], "base_linvel": run.qvel[:, :3], "base_angvel": run.qvel[:, 3:6]}
        for part, values in parts.items():
            found |= {f"{part}_{axis}": (values + noise[part])[:, i] for i, axis in enumerate("xyz")}
        columns |= found
    columns = {key: np.ascontiguousarray(values) for key, values in columns.items()}
    return Log(name, columns, LogInfo(robot.model, robot.period_s, "an owner's robot"))


def rounded(values: np.ndarray, tick: float) -> np.ndarray:
    """Values in whole ticks, where there are any."""
    return np.round(values / tick) * tick if tick else values


def model_file(spec: mujoco.MjSpec, errors: Sequence[Error]) -> str:
    """The model file that the owner has, with the largest torques that it states."""
    for error in errors:
        for actuator, most in zip(spec.actuators, [] if error.file_limit is None else error.file_limit, strict=False):
            if np.abs(actuator.forcerange).max():
                actuator.forcerange = [-most, most]
            else:
                actuator.ctrlrange = [-most, most]
    spec.compile()
    return str(spec.to_xml())


def difference(first: Sequence[Run], second: Sequence[Run], robot: OwnersRobot, with_noise: bool = False) -> float:
    """Root mean square between what joints show in two sets of runs, rad; with that of noise and resolution added."""
    squares = [np.mean((one.shown - other.shown) ** 2) for one, other in zip(first, second, strict=False)]
    added = with_noise * (robot.noise[0] ** 2 + robot.ticks[0] ** 2 / 12)
    return float(np.sqrt(np.mean(squares) + added))
