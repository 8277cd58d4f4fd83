"""Sealed checks of ``judge`` and ``compare``: random arms of plain MuJoCo, whose PD is a force outside the model.

An arm of two joints differs from its model by one to three faults, drawn from friction, damping, armature and mass at
either joint. A correction makes right changes, some of its faults, and wrong ones: a number that is not at fault, or a
fault at a third or three times its size. A pair of sets shares all faults; in half of the pairs one more acts after.
Rules, fixed before any case was drawn: a right change is doubted if it is not told ``supported``, and one that is
``undecided`` counts for neither side; a wrong one is told if it is neither ``supported`` nor ``undecided``. A change is
named if the first one named has its effect and joint; an armature for a mass of the same link, or the reverse, is not.
Run as ``python -m tests.benchmarks.referee --json <file>``; ``--cases N`` of each; three minutes for the default.
"""

import argparse
import json
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

import leapgap as lg
from leapgap.runtime.atomic_io import write_json
from tests import plain_arm
from tests.benchmarks import run_benchmark

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
ALSO = {"link_mass": {"link_payload"}}
"""Effects that say the same."""
LINKS = {"shoulder": ("upper", 1.5), "elbow": ("lower", 0.8)}
Fault = tuple[str, str]
LOGS = 2


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
    found = lg.compare(before, after, model, threads=1)
    labels = [one.label for one in found.changed]
    expected = [(EFFECTS[key], at) for key, at in new]
    first = tuple(labels[0].split(" at ")) if labels else ()
    is_first = bool(expected) and len(first) == 2 and first[1] == expected[0][1]
    is_first = is_first and first[0] in {expected[0][0]} | ALSO.get(expected[0][0], set())
    shares = {f"{key} {at}": size for (key, at), size in shared.items()}
    says = [one.says for one in found.changed]
    return {"shared": shares, "changed": expected, "told": says, "first": is_first, "unknown": found.unknown_change}


def main() -> None:
    """Draw the cases, judge them, write figures and cases."""
    options = argparse.ArgumentParser()
    options.add_argument("--json", type=Path, required=True)
    options.add_argument("--cases", type=int, default=12)
    options.add_argument("--seed", type=int, default=4601)
    options.add_argument("--tiny", action="store_true", help="one case of each")
    chosen = options.parse_args()
    corrections, pairs = [], []
    for case in range(1 if chosen.tiny else chosen.cases):
        with tempfile.TemporaryDirectory() as folder:
            corrections.append(judged(np.random.default_rng([chosen.seed, 0, case]), Path(folder)))
        with tempfile.TemporaryDirectory() as folder:
            pairs.append(compared(np.random.default_rng([chosen.seed, 1, case]), Path(folder), case % 2 == 0))
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
        print(json.dumps({**figures, "last": [corrections[-1], pairs[-1]]}), flush=True)


if __name__ == "__main__":
    run_benchmark(main)
