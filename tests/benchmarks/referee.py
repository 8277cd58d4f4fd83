"""Sealed checks of ``judge`` and ``compare``: random robots of plain MuJoCo, whose PD is a force outside the model.

An arm of two joints differs from its model by one to three faults, drawn from friction, damping, armature and mass at
either joint. A correction makes right changes, some of its faults, and wrong ones: a number that is not at fault, or a
fault at a third or three times its size. A pair of sets shares all faults; in half of the pairs one more acts after.
Pairs of a UR5e and of an A1 that trots have the errors of owners' robots (``validation.owners``) in place of these
faults, and small departures of all masses, friction and damping, alike in both sets.

Rules, fixed before any case was drawn: a right change is doubted if it is not told ``supported``, and one that is
``undecided`` counts for neither side; a wrong one is told if it is neither ``supported`` nor ``undecided``. A change is
named if the first one named has its effect and joint; an armature for a mass of the same link, or the reverse, is not.
Fits are corrections of the arm or the A1 by ``mujoco.sysid`` (extra ``peers``), of numbers that somebody chose: one
within a fifth of the truth is right; one that is off by a fifth of the largest fault or more is unsupported.
Run as ``python -m tests.benchmarks.referee --json <file>``; ``--cases N`` of each of ``--kinds``. The file is written
after each case. Seconds of a processor: 10 a correction or a fit of the arm, 20 to 40 a pair.
"""

import argparse
import json
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import mujoco
import mujoco.rollout
import numpy as np

import leapgap as lg
from leapgap.diagnosis.judge import Judgement
from leapgap.logs.log import Log, read_logs, write_log
from leapgap.robot.model import DEFAULT_MODEL
from leapgap.runtime.atomic_io import write_json
from leapgap.validation.owners.cases import OwnersCase, Plan, draw_errors, logged
from leapgap.validation.owners.plant import OwnersDrive, build
from leapgap.validation.owners.robots import ROBOTS
from tests import plain_arm
from tests.benchmarks import run_benchmark
from tests.code import ROOT

NOMINAL = {"damping": 0.05, "frictionloss": 0.0, "armature": 0.01, "mass": 1.0}
LARGEST = {"damping": 0.5, "frictionloss": 0.8, "armature": 0.03, "mass": 0.4}
"""Added at most; a fault is at least 0.4 of it. Masses are factors of the link's own."""
NOMINAL_A1 = {"damping": 0.01, "frictionloss": 0.2, "armature": 0.01, "mass": 1.0}
TITLES = {
    "damping": "damping",
    "frictionloss": "dry friction",
    "armature": "armature",
    "mass": "mass and centre of mass",
}
EFFECTS = {"damping": "joint_damping", "frictionloss": "joint_friction", "armature": "armature", "mass": "link_mass"}
ALSO = {"link_mass": {"link_payload"}, "link_payload": {"link_mass"}}
"""Effects that say the same."""
LINKS = {"shoulder": ("upper", 1.5), "elbow": ("lower", 0.8)}
KINDS = ("corrections", "pairs", "fits")
Fault = tuple[str, str]
LOGS = 2
STEP = 0.02
"""Finite differences of fits, as shares of the largest faults: files state six digits."""
NEAR = 0.2
"""A fit is right within this share of the truth; it is unsupported if it is off by this share of the largest fault."""
LARGEST_A1 = {"damping": 0.8, "frictionloss": 1.5, "armature": 0.03, "mass": 0.3}
"""Of a joint, and of the mass of the trunk."""
OWNED = ("joint_friction", "joint_damping", "armature", "position_gain", "torque_offset", "link_payload")
"""Errors of owners' robots that are drawn; a robot on feet has none of the last two."""
OWNERS = {
    "ur5e": (ROOT / "conf/withhold/models/ur5e.xml", replace(ROBOTS["ur5e_125"], length_s=1.6), "ur5e_125"),
    "a1": (DEFAULT_MODEL, replace(ROBOTS["go2"], model="a1", length_s=0.8), "go2"),
}
"""Model file, robot, and whose errors it has."""


def arm(added: dict[Fault, float]) -> str:
    """The arm with some faults, of size ``added`` each, and motors as strong as the PD that drives it."""
    xml = plain_arm.EXAMPLE.MODEL.replace('forcerange="-60 60"', 'forcerange="-600 600"')
    for joint, (_, mass) in LINKS.items():
        own = {key: NOMINAL[key] + added.get((key, joint), 0.0) for key in NOMINAL}
        attributes = " ".join(f'{key}="{own[key]:.6g}"' for key in ("damping", "frictionloss", "armature"))
        old = 'damping="0.05" armature="0.01"' if joint == "shoulder" else '{elbow} armature="0.01"'
        xml = xml.replace(old, attributes).replace(f'mass="{mass}"', f'mass="{mass * own["mass"]:.6g}"')
    return str(xml)


ARM = [(key, joint) for key in NOMINAL for joint in LINKS]


def draw(
    rng: np.random.Generator,
    count: int,
    beside: tuple[Fault, ...] = (),
    of: Sequence[Fault] = ARM,
    largest: Mapping[str, float] = LARGEST,
) -> dict[Fault, float]:
    """Some faults, none of them of the same kind at the same joint as others."""
    every = [one for one in of if one not in beside]
    return {every[i]: largest[every[i][0]] * rng.uniform(0.4, 1) for i in rng.permutation(len(every))[:count]}


def judged(rng: np.random.Generator, folder: Path) -> dict[str, Any]:
    """One correction with right and wrong changes."""
    faults = draw(rng, int(rng.integers(1, 4)))
    right = dict(list(faults.items())[: int(rng.integers(1, len(faults) + 1))])
    wrong = draw(rng, 1, tuple(faults))
    if rng.random() < 0.5 and len(faults) > len(right):  # another number of a fault
        fault = list(faults)[-1]
        wrong = {fault: faults[fault] * float(rng.choice([1 / 3, 3]))}
    nominal, corrected = folder / "nominal.xml", folder / "corrected.xml"
    nominal.write_text(arm({}))
    corrected.write_text(arm({**right, **wrong}))
    logs = plain_arm.write_parquet(folder / "logs", LOGS, arm(faults), int(rng.integers(1000)))
    told = {one.title: one for one in lg.judge(corrected, logs, nominal, threads=1).changes}

    def verdicts(of: dict[Fault, float]) -> dict[str, str]:
        titles = [f"{TITLES[key]} of {LINKS[at][0] if key == 'mass' else at}" for key, at in of]
        return {title: told[title].verdict for title in titles}

    named = {f"{key} {at}": size for (key, at), size in faults.items()}
    return {"faults": named, "right": verdicts(right), "wrong": verdicts(wrong)}


def fitted(rng: np.random.Generator, folder: Path) -> dict[str, Any]:
    """One correction by ``mujoco.sysid``, of numbers that somebody chose: not all faults are among them."""
    faults = draw(rng, int(rng.integers(1, 4)))
    chosen = choose(rng, faults, ARM)
    fit_on, judge_on = (
        plain_arm.write_parquet(folder / name, LOGS, arm(faults), int(rng.integers(1000))) for name in ("fit", "logs")
    )
    changes = sysid_fit(read_logs(fit_on), chosen)
    nominal, corrected = folder / "nominal.xml", folder / "corrected.xml"
    nominal.write_text(arm({}))
    corrected.write_text(arm(changes))
    names = {(key, at): f"{TITLES[key]} of {LINKS[at][0] if key == 'mass' else at}" for key, at in changes}
    return judged_fit("arm", lg.judge(corrected, judge_on, nominal, threads=1), faults, changes, names, LARGEST)


def choose(rng: np.random.Generator, faults: dict[Fault, float], every: Sequence[Fault]) -> list[Fault]:
    """Four numbers and the faults, in seven of ten cases all but one of these."""
    left_out = list(faults)[int(rng.integers(len(faults)))] if rng.random() < 0.7 else None
    chosen = [every[i] for i in rng.permutation(len(every))[:4]] + list(faults)
    return [one for one in dict.fromkeys(chosen) if one != left_out]


def judged_fit(
    robot: str,
    judgement: Judgement,
    faults: dict[Fault, float],
    changes: dict[Fault, float],
    names: dict[Fault, str],
    largest: Mapping[str, float],
) -> dict[str, Any]:
    """What is told of the changes of a fit, by their names."""
    told, rows = {one.title: one for one in judgement.changes}, []
    for (key, at), change in changes.items():
        if one := told.get(names[key, at]):
            true = faults.get((key, at), 0.0)
            row = {"change": one.title, "fitted": change, "true": true, "is": sort_of(change, true, largest[key])}
            rows.append({**row, "verdict": one.verdict, "share": one.share})
    further = {"further": list(judgement.further), "unnamed": judgement.unnamed}
    return {"robot": robot, "faults": {f"{key} {at}": v for (key, at), v in faults.items()}, "changes": rows, **further}


def fitted_a1(rng: np.random.Generator, folder: Path) -> dict[str, Any]:
    """One correction of the A1 by ``mujoco.sysid``, on trots; all its numbers are a little off besides."""
    file, robot, _ = OWNERS["a1"]
    spec = mujoco.MjSpec.from_file(str(file))
    limit = np.array([np.abs(a.forcerange).max() for a in spec.actuators])
    drive, wear = OwnersDrive(np.array(robot.kp), np.array(robot.kd), limit), int(rng.integers(2**31))
    own = build(file, drive)
    every = [(key, joint) for key in ("damping", "frictionloss", "armature") for joint in own.names] + [
        ("mass", "trunk")
    ]
    faults = draw(rng, int(rng.integers(1, 4)), (), every, LARGEST_A1)
    chosen = choose(rng, faults, every)
    plans = [Plan.draw(robot, own, rng) for _ in range(2 * LOGS)]
    true = build(file, drive, np.random.default_rng(wear), (), [changed(faults)])
    runs = [plan.run(true, robot) for plan in plans]
    logs = [
        logged(f"log_{i}", *pair, robot, [], own.names, rng) for i, pair in enumerate(zip(plans, runs, strict=True))
    ]
    for log in logs[LOGS:]:
        write_log(log, folder / "logs" / f"{log.name}.parquet")
    sizes = np.array([LARGEST_A1[key] for key, _ in chosen])

    def errors(x: np.ndarray) -> np.ndarray:
        robot_now = build(file, drive, None, (), [changed(dict(zip(chosen, (sizes * x).tolist(), strict=True)))])
        found = []
        for log, plan in zip(logs[:LOGS], plans, strict=False):
            run = plan.run(robot_now, robot)
            q, v = (log.per_joint(name, own.names) for name in ("joint_pos", "joint_vel"))
            base = np.stack([log[f"base_pos_{axis}"] for axis in "xyz"], axis=1)
            parts = ((run.shown - q) / 0.03, (run.speed - v) / 2, (run.qpos[:, :3] - base) / 0.03)
            found.append(np.concatenate([np.clip(one[::4], -30, 30).ravel() for one in parts]))
        return np.concatenate(found)

    starts = {(key, at): -0.8 * NOMINAL_A1[key] for key, at in chosen}
    changes = optimised(errors, chosen, sizes, starts, 10)
    nominal, corrected = folder / "nominal.xml", folder / "corrected.xml"
    nominal.write_text(spec.to_xml())
    for (key, at), change in changes.items():
        if key == "mass":
            spec.body(at).mass *= 1 + change
        else:
            setattr(spec.joint(at), key, np.add(getattr(spec.joint(at), key), change))
    corrected.write_text(spec.to_xml())
    names = {(key, at): f"{TITLES[key]} of {at}" for key, at in changes}
    found = lg.judge(corrected, folder / "logs", nominal, threads=1)
    return judged_fit("a1", found, faults, changes, names, LARGEST_A1)


def changed(numbers: dict[Fault, float]) -> Callable[[mujoco.MjModel], None]:
    """What adds some numbers to joints of a model, and factors to masses."""

    def apply(model: mujoco.MjModel) -> None:
        for (key, at), size in numbers.items():
            if key == "mass":
                model.body_mass[model.body(at).id] *= 1 + size
            else:
                getattr(model, f"dof_{key}")[model.joint(at).dofadr[0]] += size

    return apply


def sort_of(change: float, true: float, largest: float) -> str:
    """Whether a fitted change is right, unsupported, or of no size to speak of."""
    if abs(change - true) <= NEAR * abs(true):
        return "right"
    return "unsupported" if abs(change - true) >= NEAR * max(abs(true), largest) else "neither"


def sysid_fit(logs: list[Log], chosen: list[Fault]) -> dict[Fault, float]:
    """What ``mujoco.sysid`` adds to the chosen numbers, on replays of whole logs, errors by sensor noise."""
    joints, sizes = plain_arm.JOINTS, np.array([LARGEST[key] for key, _ in chosen])
    own = mujoco.MjModel.from_xml_string(arm({}))
    steps, seen = round(plain_arm.PERIOD_S / own.opt.timestep), slice(None, None, 10)
    full, controls, measured = [], [], []
    for log in logs:
        q, v, wanted, speed = (log.per_joint(name, joints) for name in ("joint_pos", "joint_vel", "cmd_pos", "cmd_vel"))
        full.append(np.concatenate([[0.0], q[0], v[0]]))
        controls.append(np.repeat(plain_arm.KP * wanted + plain_arm.KD * speed, steps, axis=0))
        measured.append(np.concatenate([q, v], axis=1)[seen])

    def replayed(x: np.ndarray) -> np.ndarray:
        model = mujoco.MjModel.from_xml_string(arm(dict(zip(chosen, (sizes * x).tolist(), strict=True))))
        model.actuator_biasprm[:, 1:3] = -plain_arm.KP, -plain_arm.KD
        model.actuator_gainprm[:, 0] = 1
        states, _ = mujoco.rollout.rollout(model, mujoco.MjData(model), np.array(full), np.array(controls))
        at = np.concatenate([np.array(full)[:, None], states], axis=1)[:, :-1:steps][:, seen, 1:]
        return ((at - np.array(measured)) / np.repeat([2e-4, 5e-3], len(joints))).ravel()

    return optimised(replayed, chosen, sizes, {(key, at): -0.8 * NOMINAL[key] for key, at in chosen}, 30)


def optimised(
    errors: Callable[[np.ndarray], np.ndarray],
    chosen: list[Fault],
    sizes: np.ndarray,
    least: dict[Fault, float],
    iterations: int,
) -> dict[Fault, float]:
    """What ``mujoco.sysid`` adds to the chosen numbers, in steps of ``sizes`` and not below ``least``."""
    from mujoco import sysid  # the extra ``peers``

    def residual(x: np.ndarray, _: Any) -> tuple[list[np.ndarray], None, None]:
        columns = [errors(one) for one in x.reshape(len(chosen), -1).T]
        return [np.stack(columns, axis=1) if x.ndim > 1 else columns[0]], None, None

    parameters = sysid.ParameterDict()
    for (key, at), size in zip(chosen, sizes, strict=True):
        parameters.add(sysid.Parameter(f"{key} {at}", 0.0, least[key, at] / size, 2.0))
    parameters.move_off_bounds()
    found, _ = sysid.optimize(parameters, residual, verbose=False, eps=STEP, max_iters=iterations)
    return dict(zip(chosen, (sizes * found.as_vector()).tolist(), strict=True))


def compared(rng: np.random.Generator, folder: Path, changes: bool) -> dict[str, Any]:
    """One pair of sets."""
    shared = draw(rng, int(rng.integers(1, 4)))
    new = draw(rng, 1, tuple(shared)) if changes else {}
    model = folder / "nominal.xml"
    model.write_text(arm({}))
    before, after = (
        plain_arm.write_parquet(folder / name, LOGS, arm(of), int(rng.integers(1000)))
        for name, of in (("before", shared), ("after", {**shared, **new}))
    )
    shares = {f"{key} {at}": size for (key, at), size in shared.items()}
    return {"robot": "arm", "shared": shares, **told(before, after, model, [(EFFECTS[key], at) for key, at in new])}


def told(
    before: Path, after: Path, model: Path, new: list[tuple[str, str]], same: tuple[str, ...] = ()
) -> dict[str, Any]:
    """What is told of a pair in which ``new`` changed: effect and place; effects ``same`` do just that."""
    found = lg.compare(before, after, model, threads=1)
    first = (*found.changed[0].label.split(" at "), "all")[:2] if found.changed else ("", "")
    is_first = any(first[1] == at and first[0] in {name, *same} | ALSO.get(name, set()) for name, at in new)
    says = {"told": [one.says for one in found.changed], "guesses": [one.says for one in found.guesses]}
    return {"changed": new, "first": is_first, **says, "unnamed": found.unnamed, "varying": found.varying}


def owned(rng: np.random.Generator, folder: Path, changes: bool, name: str) -> dict[str, Any]:
    """One pair of sets of an owner's robot."""
    file, robot, errors_of = OWNERS[name]
    actuators = mujoco.MjSpec.from_file(str(file)).actuators
    limit = np.array([max(np.abs(a.ctrlrange).max(), np.abs(a.forcerange).max()) for a in actuators])
    drive, wear = OwnersDrive(np.array(robot.kp), np.array(robot.kd), limit), int(rng.integers(2**31))
    nominal, kinds = build(file, drive), OWNED[: 4 if robot.walks else 6]
    plans = [Plan.draw(robot, nominal, rng) for _ in range(2 * LOGS)]
    drawn = tuple(rng.permutation(kinds)[: int(rng.integers(2, 4))].tolist())
    errors = draw_errors(
        OwnersCase("pairs", errors_of, drawn, 0), robot, nominal, plans[0].run(nominal, robot), limit, rng
    )
    shared, new = errors[:-1], errors[-1:] if changes else []
    for i, plan in enumerate(plans):
        acting = [*shared, *(new if i >= LOGS else [])]
        own = replace(drive, **{key: value for one in acting for key, value in one.drive.items()})
        specs, models = [one.spec for one in acting if one.spec], [one.model for one in acting if one.model]
        run = plan.run(build(file, own, np.random.default_rng(wear), specs, models), robot)
        log = logged(f"log_{i}", plan, run, robot, acting, nominal.names, rng)
        write_log(log, folder / ("after" if i >= LOGS else "before") / f"log_{i}.parquet")
    expected, same = [(one.name, one.location) for one in new], new[0].same if new else ()
    shares = {f"{one.name} {one.location}": one.parameters for one in shared}
    return {"robot": name, "shared": shares, **told(folder / "before", folder / "after", file, expected, same)}


def main() -> None:
    """Draw the cases, judge them, write figures and cases."""
    options = argparse.ArgumentParser()
    options.add_argument("--json", type=Path, required=True)
    options.add_argument("--cases", type=int, default=12)
    options.add_argument("--first", type=int, default=0, help="number of the first case; what the file has stays")
    options.add_argument("--seed", type=int, default=4601)
    options.add_argument("--kinds", nargs="*", choices=KINDS, default=KINDS)
    options.add_argument("--robots", nargs="*", choices=["arm", *OWNERS], default=["arm"], help="of pairs and fits")
    options.add_argument("--tiny", action="store_true", help="one case of each")
    chosen = options.parse_args()
    rows: dict[str, list[dict[str, Any]]] = {kind: [] for kind in KINDS}
    if chosen.first:
        rows |= {kind: own for kind, own in json.loads(chosen.json.read_text()).items() if kind in KINDS}
    for case in range(chosen.first, chosen.first + (1 if chosen.tiny else chosen.cases)):
        tasks: list[tuple[str, Callable[[np.random.Generator, Path], dict[str, Any]]]] = [
            ("corrections", judged),
            ("pairs", partial(compared, changes=case % 2 == 0)),
            ("fits", fitted),
        ]
        tasks = [one for one in tasks if one[0] in chosen.kinds and (one[0] == "corrections" or "arm" in chosen.robots)]
        tasks += [("fits", fitted_a1)] if "fits" in chosen.kinds and "a1" in chosen.robots else []
        if "pairs" in chosen.kinds:
            own = [name for name in chosen.robots if name != "arm"]
            tasks += [("pairs", partial(owned, changes=case % 2 == 0, name=name)) for name in own]
        for kind, made in tasks:
            with tempfile.TemporaryDirectory() as folder:
                rng = np.random.default_rng([chosen.seed, KINDS.index(kind), case])
                rows[kind].append(made(rng, Path(folder)))
            write_json(chosen.json, {"figures": figures(rows), **rows})
            print(json.dumps({**figures(rows), "last": rows[kind][-1]}), flush=True)


def figures(rows: dict[str, list[dict[str, Any]]]) -> dict[str, int]:
    """Counts of the cases so far."""
    right = [verdict for one in rows["corrections"] for verdict in one["right"].values()]
    wrong = [verdict for one in rows["corrections"] for verdict in one["wrong"].values()]
    judged_by = {"": (right, wrong)}
    for robot, name in (("arm", "fits_"), ("a1", "a1_fits_")):
        fits = [change for one in rows["fits"] if one.get("robot", "arm") == robot for change in one["changes"]]
        of_right, of_wrong = ([one["verdict"] for one in fits if one["is"] == of] for of in ("right", "unsupported"))
        judged_by[name] = of_right, of_wrong
    found: dict[str, int] = {}
    for name, (of_right, of_wrong) in judged_by.items():
        found |= {
            f"{name}right": len(of_right),
            f"{name}right_supported": of_right.count("supported"),
            f"{name}right_doubted": len(of_right) - of_right.count("supported") - of_right.count("undecided"),
            f"{name}wrong": len(of_wrong),
            f"{name}wrong_told": len(of_wrong) - of_wrong.count("supported") - of_wrong.count("undecided"),
        }
    for robot in ("arm", *OWNERS):
        own = [one for one in rows["pairs"] if one["robot"] == robot]
        changed, same = ([one for one in own if bool(one["changed"]) is is_new] for is_new in (True, False))
        found |= {
            f"{robot}_changed": len(changed),
            f"{robot}_change_first": sum(one["first"] for one in changed),
            f"{robot}_same": len(same),
            f"{robot}_same_none_named": sum(not one["told"] for one in same),
        }
    return found


if __name__ == "__main__":
    run_benchmark(main)
