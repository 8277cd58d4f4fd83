"""Sealed checks of ``judge`` and ``compare``: random robots of plain MuJoCo, whose PD is a force outside the model.

An arm of two joints differs from its model by one to three faults, drawn from friction, damping, armature and mass at
either joint. A correction makes right changes, some of its faults, and wrong ones: a number that is not at fault, or a
fault at a third or three times its size. A pair of sets shares all faults; in half of the pairs one more acts after.
Pairs of a UR5e and of an A1 that trots have the errors of owners' robots (``validation.owners``) in place of these
faults, and small departures of all masses, friction and damping, alike in both sets.

Rules, fixed before any case was drawn: a right change is doubted if it is not told ``supported``, and one that is
``undecided`` counts for neither side; a wrong one is told if it is neither ``supported`` nor ``undecided``. A change is
named if the first one named has its effect and joint; an armature for a mass of the same link, or the reverse, is not.
Run as ``python -m tests.benchmarks.referee --json <file>``; ``--cases N`` of each kind of ``--robots``; corrections are
of the arm. The file is written after each case. Seconds of a processor: 10 a correction, 20 to 40 a pair of the arm.
"""

import argparse
import json
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

import leapgap as lg
from leapgap.logs.log import write_log
from leapgap.robot.model import DEFAULT_MODEL
from leapgap.runtime.atomic_io import write_json
from leapgap.validation.owners.cases import OwnersCase, Plan, draw_errors, logged
from leapgap.validation.owners.plant import Drive, build
from leapgap.validation.owners.robots import ROBOTS
from tests import plain_arm
from tests.benchmarks import run_benchmark
from tests.code import ROOT

NOMINAL = {"damping": 0.05, "frictionloss": 0.0, "armature": 0.01, "mass": 1.0}
LARGEST = {"damping": 0.5, "frictionloss": 0.8, "armature": 0.03, "mass": 0.4}
"""Added at most; a fault is at least 0.4 of it. Masses are factors of the link's own."""
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
Fault = tuple[str, str]
LOGS = 2
OWNED = ("joint_friction", "joint_damping", "armature", "position_gain", "torque_offset", "link_payload")
"""Errors of owners' robots that are drawn; a robot on feet has none of the last two."""
OWNERS = {
    "ur5e": (ROOT / "conf/withhold/models/ur5e.xml", replace(ROBOTS["ur5e_125"], length_s=1.6), "ur5e_125"),
    "a1": (DEFAULT_MODEL, replace(ROBOTS["go2"], model="a1", length_s=0.8), "go2"),
}
"""Model file, robot, and whose errors it has."""


def arm(added: dict[Fault, float]) -> str:
    """The arm with some faults, of size ``added`` each."""
    xml = plain_arm.EXAMPLE.MODEL
    for joint, (_, mass) in LINKS.items():
        own = {key: NOMINAL[key] + added.get((key, joint), 0.0) for key in NOMINAL}
        attributes = " ".join(f'{key}="{own[key]:.6g}"' for key in ("damping", "frictionloss", "armature"))
        old = 'damping="0.05" armature="0.01"' if joint == "shoulder" else '{elbow} armature="0.01"'
        xml = xml.replace(old, attributes).replace(f'mass="{mass}"', f'mass="{mass * own["mass"]:.6g}"')
    return str(xml)


def draw(rng: np.random.Generator, count: int, beside: tuple[Fault, ...] = ()) -> dict[Fault, float]:
    """Some faults, none of them of the same kind at the same joint as others."""
    every = [(key, joint) for key in NOMINAL for joint in LINKS if (key, joint) not in beside]
    return {every[i]: LARGEST[every[i][0]] * rng.uniform(0.4, 1) for i in rng.permutation(len(every))[:count]}


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
    drive, wear = Drive(np.array(robot.kp), np.array(robot.kd), limit), int(rng.integers(2**31))
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
    options.add_argument("--robots", nargs="*", choices=["arm", *OWNERS], default=["arm"], help="of pairs")
    options.add_argument("--corrections", action="store_true", help="as many corrections of the arm, too")
    options.add_argument("--tiny", action="store_true", help="one case of each")
    chosen = options.parse_args()
    kept = json.loads(chosen.json.read_text()) if chosen.first else {"corrections": [], "pairs": []}
    corrections, pairs = kept["corrections"], kept["pairs"]
    for case in range(chosen.first, chosen.first + (1 if chosen.tiny else chosen.cases)):
        if chosen.corrections:
            with tempfile.TemporaryDirectory() as folder:
                corrections.append(judged(np.random.default_rng([chosen.seed, 0, case]), Path(folder)))
        for name in chosen.robots:
            with tempfile.TemporaryDirectory() as folder:
                rng, changes = np.random.default_rng([chosen.seed, 1, case]), case % 2 == 0
                own = (rng, Path(folder), changes)
                pairs.append(compared(*own) if name == "arm" else owned(*own, name))
        right = [verdict for one in corrections for verdict in one["right"].values()]
        wrong = [verdict for one in corrections for verdict in one["wrong"].values()]
        changed, same = ([one for one in pairs if bool(one["changed"]) is is_new] for is_new in (True, False))
        figures = {
            "right": len(right),
            "right_supported": right.count("supported"),
            "right_doubted": len(right) - right.count("supported") - right.count("undecided"),
            "wrong": len(wrong),
            "wrong_told": len(wrong) - wrong.count("supported") - wrong.count("undecided"),
            "changed": len(changed),
            "change_first": sum(one["first"] for one in changed),
            "same": len(same),
            "same_none_named": sum(not one["told"] for one in same),
        }
        write_json(chosen.json, {"figures": figures, "corrections": corrections, "pairs": pairs})
        print(json.dumps({**figures, "last": [*corrections[-1:], *pairs[-1:]]}), flush=True)


if __name__ == "__main__":
    run_benchmark(main)
