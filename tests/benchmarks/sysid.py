"""Side by side with ``mujoco.sysid``: every parameter fitted at once, on the same logs, with the same weights.

Both see four jumps and are judged on further ones of the same robot. The peer gets what its authors advise: scaled
parameters, starts off the bounds, Gauss–Newton in bounds, its own 95 % intervals; its residuals are those of the
diagnosis (replays of 0.1 s from the log, whitened by sensor noise), so that only the way to an answer differs. A
parameter whose interval leaves out nominal is what it says. Of ours there are two products: the answer, and the best
simulator, which says what it believes of its own numbers. Seconds are of processors, of all threads together, so that
other work on the machine hardly counts; those of the answer are without, those of the best simulator with its own
beside the diagnosis. Needs ``pip install -e ".[peers]"``. Run as
``python -m tests.benchmarks.sysid --json <file>``; takes about half an hour. ``--only pair`` runs the cases whose name
begins so; the file is written after each case.
"""

import argparse
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from mujoco import sysid
from omegaconf import OmegaConf

from leapgap import effects
from leapgap.diagnosis.best_simulator import BestFit, BestSimulator, FitOfAll
from leapgap.diagnosis.candidates import split_numbers
from leapgap.diagnosis.diagnose import diagnose
from leapgap.diagnosis.experiment_forecast import errors_of
from leapgap.diagnosis.gap import candidate_squares, closure, headline_gap, noise_floor, resamples
from leapgap.diagnosis.hypotheses import list_hypotheses
from leapgap.diagnosis.judged_logs import JudgedLogs
from leapgap.diagnosis.settings import Settings
from leapgap.diagnosis.short_rollouts import ShortRollouts
from leapgap.effects.base import Effect
from leapgap.logs.log import Log
from leapgap.robot.model import Robot
from leapgap.runtime.atomic_io import write_json
from leapgap.simulation.replay import Replayer
from stages.common import read_config
from tests.benchmarks import run_benchmark
from tests.benchmarks.diagnose import tiny
from tests.benchmarks.diagnosis_injected import DISTANCES, Case, cases, effect_of_size, jumps_of

TRIPLES = (
    (("joint_damping", 0.4), ("payload", 1.0), ("command_delay", 0.005)),
    (("torque_gain", 0.9), ("joint_friction", 0.7), ("com_offset", 0.02)),
    (("motor_lag", 0.005), ("foot_compliance", 0.03), ("leg_mass", 1.2)),
)
CHOSEN = (
    "moderate joint_damping", "moderate torque_gain", "moderate payload", "moderate command_delay",
    "moderate foot_friction", "moderate encoder_bias", "large leg_mass", "placed torque_gain at RR_calf",
    "none",
)  # fmt: skip
STEP, MOST_ITERATIONS = 0.02, 30
"""Finite differences, in moderate departures; iterations of the peer."""
PRODUCTS = ("leapgap", "best", "sysid")
"""Our answer, our best simulator, and the peer."""


def peer(
    logs: Sequence[Log], robot: Robot, settings: Settings, iterations: int
) -> tuple[dict[str, list[float]], tuple[Effect, ...]]:
    """Every parameter at once: those whose interval leaves out nominal, as departures, and all effects."""
    everything = [h for h in list_hypotheses(list(effects.by_default()), robot, None) if h.location == "all"]
    replayer = Replayer(robot)
    judged = JudgedLogs.of(logs, robot)
    most = min(settings.most_pieces, settings.pieces_per_log * len(logs))
    bare = ShortRollouts.of(judged.states, replayer, settings.horizon_s, settings.every_s, most)
    evidence = bare.whiten_for(bare.on_every_log(()))
    names = [(h, k, p) for h in everything for k, p in enumerate(h.parameters)]
    scale = np.array([h.moderate[k] for h, k, _ in names])
    nominal = np.array([p.nominal for _, _, p in names])
    parameters = sysid.ParameterDict()
    for (h, _, p), size in zip(names, scale, strict=True):
        low, high = sorted(((p.lower - p.nominal) / size, (p.upper - p.nominal) / size))
        parameters.add(sysid.Parameter(f"{h.name}.{p.name}", 0.0, low, high))
    parameters.move_off_bounds()

    def acting(x: np.ndarray) -> tuple[Effect, ...]:
        own = split_numbers(everything, nominal + scale * x)
        return tuple(h.on("", numbers) for h, numbers in zip(everything, own, strict=True))

    def residual(x: np.ndarray, _: sysid.ParameterDict) -> tuple[list[np.ndarray], None, None]:
        columns = x.reshape(len(names), -1).T
        found = errors_of(evidence, [acting(one) for one in columns])
        errors = np.stack([of.ravel() for of in found], axis=1)
        return [errors if x.ndim > 1 else errors[:, 0]], None, None

    fitted, result = sysid.optimize(parameters, residual, verbose=False, eps=STEP, max_iters=iterations)
    x = fitted.as_vector()
    _, half = sysid.calculate_intervals(residual(x, fitted)[0], result.jac)
    conclusion: dict[str, list[float]] = {}
    for (h, _, _), value, width in zip(names, x, half, strict=True):
        if abs(value) > width:
            conclusion.setdefault(h.name, []).append(float(value))
    return conclusion, acting(x)


def heldout(correction: Sequence[Effect], proof: Sequence[Log], robot: Robot, settings: Settings) -> dict[str, float]:
    """Headline gap of a correction on jumps that nobody saw, and how much of the nominal one it closes."""
    judged, replayer = JudgedLogs.of(proof, robot), Replayer(robot)
    nominal, after = candidate_squares(judged, replayer, [[()] * len(proof), [tuple(correction)] * len(proof)])
    floor = noise_floor(judged, replayer, settings.noise_draws, np.random.default_rng(0))
    closed = closure(
        nominal, after, floor, judged.value_counts, resamples(len(proof), 1, np.random.default_rng(0))
    ).value
    return {"gap_nominal": headline_gap(nominal, judged), "gap": headline_gap(after, judged), "closure": closed}


@contextmanager
def best_timed() -> Iterator[list[float]]:
    """Processor seconds that best simulators take."""
    seconds: list[float] = []
    best = BestFit.best

    def timed(self: BestFit, made: Callable[[], Sequence[FitOfAll]]) -> BestSimulator:
        began = time.process_time()
        found = best(self, made)
        seconds.append(time.process_time() - began)
        return found

    BestFit.best = timed  # type: ignore[method-assign]
    try:
        yield seconds
    finally:
        BestFit.best = best  # type: ignore[method-assign]


def compare(case: Case, robot: Robot, settings: Settings, iterations: int) -> dict[str, Any]:
    """One robot, both ways."""
    logs = jumps_of(case, robot)
    seen, proof = logs[: len(DISTANCES)], logs[len(DISTANCES) :]
    true = {e.name for e in case.effects}
    began = time.process_time()
    with best_timed() as of_best:
        found = diagnose(seen, robot, settings)
    ours_s = time.process_time() - began
    alone_s = ours_s - sum(of_best)
    ours = {name for names in found.report.answer for name in names[:1]}
    best, closes = found.report.best_simulator, found.report.closure_of_answer
    assert best is not None
    believed = {one.effect for one in best.believed}
    began = time.process_time()
    conclusion, everything = peer(seen, robot, settings, iterations)
    peer_s = time.process_time() - began
    return {
        "case": case.label,
        "true": sorted(true),
        "leapgap": {
            "says": sorted(ours),
            "wrong": len(ours - true),
            "missed": len(true - ours),
            "seconds": alone_s,
            "promised": closes.value if closes else 0.0,
            **heldout(found.correction, proof, robot, settings),
        },
        "best": {
            "source": best.source,
            "says": sorted(believed),
            "wrong": len(believed - true),
            "missed": len(true - believed),
            "seconds": ours_s,
            "seconds_of_its_own": sum(of_best),
            "promised": best.closure.value,
            **heldout(best.effects, proof, robot, settings),
        },
        "sysid": {
            "says": sorted(conclusion),
            "wrong": len(set(conclusion) - true),
            "missed": len(true - set(conclusion)),
            "seconds": peer_s,
            **heldout(everything, proof, robot, settings),
        },
    }


def summary(rows: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Means over the cases."""
    keys = ("wrong", "missed", "seconds", "gap", "closure")
    with_gap = [row for row in rows if row["true"]]
    return {
        who: {key: float(np.mean([row[who][key] for row in (with_gap if key == "closure" else rows)])) for key in keys}
        for who in PRODUCTS
    }


def chosen_cases() -> list[Case]:
    """Some single causes, all pairs, the triples, and nothing."""
    every = cases()
    single = [next(case for case in every if case.label.startswith(label)) for label in CHOSEN]
    triples = [
        Case("triple", tuple(effect_of_size(*one) for one in triple), len(every) + k)
        for k, triple in enumerate(TRIPLES)
    ]
    return [*(case for case in every if case.kind == "pair"), *triples, *single]


def main() -> None:
    """Run the comparison and write its figures as JSON."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--json", type=Path)
    parser.add_argument("--only", nargs="*", default=[""])
    parser.add_argument("--tiny", action="store_true", help="smallest counts, to see that it runs")
    arguments = parser.parse_args()
    robot = Robot.load()
    settings = read_config(Settings, OmegaConf.load("params.yaml").diagnose.settings, "diagnose.settings")
    settings, iterations = (replace(tiny(settings), best=True), 1) if arguments.tiny else (settings, MOST_ITERATIONS)
    rows: list[dict[str, Any]] = []
    for case in chosen_cases()[:1] if arguments.tiny else chosen_cases():
        if not case.label.startswith(tuple(arguments.only)):
            continue
        rows.append(compare(case, robot, settings, iterations))
        for who in PRODUCTS:
            one = rows[-1][who]
            told = f"{', '.join(one['says']) or 'nothing'}: gap {one['gap_nominal']:.3f} to {one['gap']:.3f}"
            print(f"{case.label} | {who} | {told} | {one['seconds']:.0f} s", flush=True)
        if arguments.json:
            write_json(arguments.json, {"cases": len(rows), **summary(rows), "rows": rows})
    print(OmegaConf.to_yaml(OmegaConf.create(summary(rows))))


if __name__ == "__main__":
    run_benchmark(main)
