"""Does the diagnosis name what was put in: every effect at moderate and large size, single places, pairs, nothing?

Four jumps a case (own references of 40 to 70 cm, front feet on blocks of up to 3 cm) by the nominal robot with the
effect, with sensor noise, in the diagnosing simulation itself; four more jumps of the same robot tell what the answer
really closes. Run as ``python -m tests.benchmarks.diagnosis_injected --json <file>``, in two processes; ``--only``
takes the first words of cases, ``--tsv`` a file for one line a case.
"""

import argparse
import multiprocessing
import time
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from omegaconf import OmegaConf

from leapgap import effects
from leapgap.diagnosis.checks import clock_of, run_checks
from leapgap.diagnosis.diagnose import Diagnosis, diagnose
from leapgap.diagnosis.gap import candidate_squares, closure, noise_floor, resamples
from leapgap.diagnosis.hypotheses import Hypothesis
from leapgap.diagnosis.judged_logs import JudgedLogs
from leapgap.diagnosis.settings import Settings
from leapgap.effects.base import Effect
from leapgap.errors import InputError
from leapgap.logs.log import Log, read_log
from leapgap.robot.model import Robot
from leapgap.runtime.atomic_io import write_json
from leapgap.simulation.open_loop import Course, MotionPlan, run_open_loop, terrain_slots
from leapgap.simulation.replay import Replayer
from leapgap.simulation.sensors import SensorNoise
from stages.common import read_config
from tests.benchmarks import run_benchmark
from tests.benchmarks.diagnose import tiny

REFERENCES = Path("data/references/own")
DISTANCES = (40, 50, 60, 70)
PROOF = 4
HIGHEST_BLOCK_M = 0.03
LARGE = {
    "aerodynamic_drag": 3.0, "armature": 0.05, "com_offset": 0.06, "command_delay": 0.010, "encoder_bias": 0.08,
    "foot_compliance": 0.06, "foot_friction": 0.3, "ground_height": 0.06, "ground_slope": 0.08, "joint_damping": 1.0,
    "joint_friction": 2.5, "leg_geometry": 0.01, "leg_mass": 1.6, "motor_lag": 0.010, "payload": 2.5,
    "sample_period": 1.15, "state_latency": 0.030, "torque_gain": 0.7, "torque_speed_limit": 13.0, "trunk_inertia": 2.0,
}  # fmt: skip
"""Of the first parameter; moderate ones stand with the effects."""
PLACED = (
    ("torque_gain", "RR_calf", 0.7), ("torque_gain", "FL_thigh", 0.85), ("joint_friction", "RL_calf", 2.5),
    ("joint_damping", "rear", 0.4), ("foot_compliance", "RR", 0.06), ("ground_height", "front", 0.03),
    ("encoder_bias", "calf", 0.03),
)  # fmt: skip
PAIRS = (
    (("joint_damping", 0.4), ("payload", 1.0)), (("torque_gain", 0.85), ("command_delay", 0.005)),
    (("com_offset", 0.03), ("joint_friction", 1.0)), (("armature", 0.02), ("foot_compliance", 0.04)),
    (("torque_speed_limit", 16.0), ("leg_mass", 1.3)), (("ground_slope", 0.03), ("motor_lag", 0.005)),
)  # fmt: skip
NONE = 4
DETECTABLE = 5.0
"""Of squares: what is twice the noise floor, and the floor itself."""


@dataclass(frozen=True)
class Case:
    """A simulated robot with the effects that are injected into it."""

    kind: str
    effects: tuple[Effect, ...]
    seed: int

    @property
    def label(self) -> str:
        """Name of the case in the output, such as ``single joint_damping 0.4``."""
        parts = (f"{e.name} at {e.location} {first_value(e):g}" for e in self.effects)
        return f"{self.kind} {' + '.join(parts)}".strip()


def first_value(effect: Effect) -> float:
    """Value of the first parameter of an effect."""
    return next(iter(effect.values.values()))


def effect_of_size(name: str, value: float, location: str = "all") -> Effect:
    """An effect with a given value of its first parameter."""
    return effects.effect(name, location, **{next(iter(effects.known()[name].declarations())): value})


def cases() -> list[Case]:
    """All cases of the benchmark; the seed of a case is its position."""
    found: list[tuple[str, tuple[Effect, ...]]] = []
    for name, kind in effects.by_default().items():
        found.append(("moderate", (effect_of_size(name, kind.parameters(Robot.load())[0].moderate),)))
        found.append(("large", (effect_of_size(name, LARGE[name]),)))
    found += [("placed", (effect_of_size(name, value, location),)) for name, location, value in PLACED]
    found += [("pair", tuple(effect_of_size(*one) for one in pair)) for pair in PAIRS]
    found += [("none", ())] * NONE
    return [Case(kind, own, seed) for seed, (kind, own) in enumerate(found)]


def jumps_of(case: Case, robot: Robot) -> list[Log]:
    """Jumps of a case: those to diagnose, then those to measure the realised closure on."""
    rng = np.random.default_rng(case.seed)
    paths = [REFERENCES / f"h00_d{d}.parquet" for d in DISTANCES]
    references = [read_log(path) for path in paths if path.is_file()]
    if not references:
        raise InputError(REFERENCES, "no plans", "plans of the pipeline", "run dvc repro first")
    plans = [
        MotionPlan(f"jump_{i}", references[i % len(references)], round(float(rng.uniform(0, HIGHEST_BLOCK_M)), 4))
        for i in range(len(DISTANCES) + PROOF)
    ]
    assert terrain_slots(plans) == 1
    return run_open_loop(plans, robot, case.effects, SensorNoise(), Course(), rng)


def realised_closure(found: Diagnosis, proof: Sequence[Log], robot: Robot, settings: Settings) -> float | None:
    """Closure of the answer on jumps that the diagnosis never saw; their own clock where a value differs by log.

    None where the effect changes these jumps by less than twice the noise floor.
    """
    judged, replayer = JudgedLogs.of(proof, robot), Replayer(robot, threads=1)
    clock = clock_of(run_checks(judged.logs, robot, settings.check_thresholds))
    corrected = []
    for jump in judged.logs:
        own = []
        for effect, cause in zip(found.correction, found.report.causes, strict=False):
            if cause.per_log and clock:
                log, values = next(iter(cause.per_log.items()))
                seen = next(c.per_log for c in found.report.checks if c.name == "joint_clock")[log]
                share = (next(iter(values.values())) - 1) / (seen - 1)
                effect = Hypothesis(type(effect), robot, effect.location, clock).on(jump.name, np.array([share]))
            own.append(effect)
        corrected.append(tuple(own))
    nominal, after = candidate_squares(judged, replayer, [[()] * len(proof), corrected])
    floor = noise_floor(judged, replayer, settings.noise_draws, np.random.default_rng(0))
    if nominal.sum() < DETECTABLE * floor.sum():
        return None
    return closure(nominal, after, floor, judged.value_counts, resamples(len(proof), 1, np.random.default_rng(0))).value


def judge(case: Case, small: bool = False) -> dict[str, Any]:
    """Diagnose a case and put truth and answer side by side; ``small``: two jumps, in seconds."""
    robot = Robot.load()
    settings = read_config(Settings, OmegaConf.load("params.yaml").diagnose.settings, "diagnose.settings")
    settings = tiny(settings) if small else settings
    logs = jumps_of(case, robot)
    began = time.process_time()
    found = diagnose(logs[: 2 if small else len(DISTANCES)], robot, settings, threads=1)
    seconds = time.process_time() - began
    report = found.report
    names = {name for names in report.answer for name in names}
    told = []
    for effect in case.effects:
        cause = next((c for c in report.causes if c.effect == effect.name), None)
        for p in effect.parameters(robot, effect.location) if cause and effect.name in names else ():
            true, estimate = effect.values[p.name], cause.parameters[p.name]
            if true != p.nominal:
                error = abs(estimate.value - true) / abs(true - p.nominal)
                told.append((error, estimate.ci95[0] <= true <= estimate.ci95[1]))
    promised = report.closure_of_answer
    return {
        "case": case.label,
        "kind": case.kind,
        "verdict": report.verdict,
        "answer": [list(n) for n in report.answer],
        "first": report.causes[0].effect if report.causes and report.answer else None,
        "true": [e.name for e in case.effects],
        "located": [
            (e.location, next((c.location for c in report.causes if c.effect == e.name), None)) for e in case.effects
        ],
        "told": told,
        "promised": promised.value if promised else None,
        "realised": realised_closure(found, logs[len(DISTANCES) :], robot, settings) if promised else None,
        "cpu_s": seconds,
    }


def share(values: list[bool]) -> float | None:
    """Share of true values; None where there are none."""
    return float(np.mean(values)) if values else None


def scores(outcomes: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """The keys of ``metrics/diagnosis.json``."""
    alone = [o for o in outcomes if o["kind"] in ("moderate", "large", "placed")]
    told = [t for o in outcomes for t in o["told"]]
    promises = [abs(o["promised"] - o["realised"]) for o in outcomes if None not in (o["promised"], o["realised"])]
    names = [{n for names in o["answer"] for n in names} for o in outcomes]
    return {
        "cases": len(outcomes),
        "injected_named_first": share([o["first"] in o["true"] for o in alone]),
        "injected_named_alone": share([o["verdict"] == "named" and o["answer"] == [o["true"]] for o in alone]),
        "injected_parameter_error_median": float(np.median([e for e, _ in told])) if told else None,
        "injected_coverage": share([bool(c) for _, c in told]),
        "closure_promise_error": float(np.mean(promises)) if promises else None,
        "closure_promise_error_median": float(np.median(promises)) if promises else None,
        "none_correct": share([o["verdict"] == "none" for o in outcomes if o["kind"] == "none"]),
        "pairs_both_named": share(
            [set(o["true"]) <= n for o, n in zip(outcomes, names, strict=True) if o["kind"] == "pair"]
        ),
        "locations_right": share(
            [true == conclusion for o in outcomes if o["kind"] == "placed" for true, conclusion in o["located"]]
        ),
    }


def main() -> None:
    """Diagnose all and write the scores."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--json", type=Path)
    parser.add_argument("--tsv", type=Path)
    parser.add_argument("--only", default="")
    parser.add_argument("--tiny", action="store_true", help="smallest counts, to see that it runs")
    arguments = parser.parse_args()
    chosen = [case for case in cases() if case.label.startswith(arguments.only)]
    if arguments.tiny:
        chosen = [case for case in chosen if [effect.name for effect in case.effects] == ["joint_damping"]][:1]
    outcomes = []
    with ProcessPoolExecutor(2, mp_context=multiprocessing.get_context("spawn")) as pool:
        for outcome in pool.map(partial(judge, small=arguments.tiny), chosen):
            outcomes.append(outcome)
            conclusion = " + ".join(" or ".join(names) for names in outcome["answer"])
            numbers = " ".join(f"{100 * e:.1f}%{'' if covered else '!'}" for e, covered in outcome["told"])
            closes = "/".join("" if outcome[key] is None else f"{outcome[key]:.2f}" for key in ("promised", "realised"))
            line = "\t".join(
                [
                    outcome["case"],
                    outcome["verdict"],
                    conclusion,
                    str(outcome["located"]),
                    numbers,
                    closes,
                    f"{outcome['cpu_s']:.0f}",
                ]
            )
            print(line, flush=True)
            if arguments.tsv:
                with arguments.tsv.open("a", encoding="utf-8") as file:
                    file.write(line + "\n")
    found = scores(outcomes)
    for key, value in found.items():
        print(f"{key}: {value}")
    if arguments.json:
        write_json(arguments.json, found)


if __name__ == "__main__":
    run_benchmark(main)
