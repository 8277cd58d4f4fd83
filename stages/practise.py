"""Practice of the learned MPC on simulated hardware: rounds of jumps, each with the model of all rounds before it.

``land`` reads these jumps. A killed run goes on with the first jump that is not there.

Examples:

    python -m stages.practise 'land.hardware=[soft]' 'land.methods=[learned_variable]' practise.out=practice
"""

from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from omegaconf import DictConfig

from leapgap.jumping.experiments.bench import TrialRunner
from leapgap.jumping.experiments.landing_experiment import RUNS, LandingExperiment, print_trial
from leapgap.jumping.experiments.methods.practised_mpc import PractisedMpcSettings
from leapgap.jumping.experiments.on_policy import Practised
from leapgap.jumping.experiments.rig import LandSettings
from leapgap.jumping.experiments.scores import round_value
from leapgap.jumping.learning.npz_files import write_npz
from leapgap.runtime.atomic_io import whole_file, write_json
from leapgap.runtime.cache import ResultCache
from leapgap.runtime.executor import Executor
from leapgap.runtime.output_folder import claim_folder
from stages.common import output_folder, read_config, run_stage
from stages.land import experiment_of

STAGE = "stages.practise"
FIGURES = "practice.json"


@dataclass(frozen=True)
class PractiseSettings:
    """Section ``practise`` of the configuration; what is practised stands in ``land``."""

    out: str | None
    metrics: str | None


def practise(config: DictConfig) -> None:
    """Make the rounds of every method that practises, on all hardware of ``land``; those that are there are kept."""
    section = read_config(PractiseSettings, config.practise, "practise")
    settings = read_config(LandSettings, config.land, "land")
    executor = read_config(Executor, config.executor, "executor")
    experiment = experiment_of(config, settings)
    out = claim_folder(output_folder(section.out, STAGE, (settings.references, config.robot.model), kept=True), STAGE)
    cache, figures = ResultCache(out / RUNS), dict[str, dict[str, Any]]()
    with executor.pool() as pool:
        for key, found in practised(experiment, TrialRunner(cache, pool.map, print_trial)):
            path = out / f"{key}.npz"
            path.parent.mkdir(parents=True, exist_ok=True)
            with whole_file(path) as beside:
                write_npz(beside, found.model.arrays())
            for name, values in figures_of(found).items():
                figures.setdefault(name, {})[key] = values
    cache.sweep()
    for metrics in (out / FIGURES, section.metrics):
        if metrics is not None:
            write_json(Path(metrics), figures)


def practised(experiment: LandingExperiment, runner: TrialRunner) -> Iterator[tuple[str, Practised]]:
    """Every practice of an experiment, with its key: hardware/method."""
    for hardware in experiment.hardware:
        rig = experiment.rig(hardware, runner)
        for name in experiment.names_on(hardware):
            method = rig.known[name]
            if isinstance(method, PractisedMpcSettings) and method.practises:
                yield f"{hardware.place}/{name}", method.practise(name, rig)


def figures_of(found: Practised) -> dict[str, Any]:
    """Figures by round, and what was kept."""
    rounds = [asdict(one) for one in found.rounds]
    by_round = {name: [round_value(one[name]) for one in rounds] for name in rounds[0] if name != "jumps"}
    return by_round | {"jumps": sum(one["jumps"] for one in rounds), "rounds_kept": found.kept}


if __name__ == "__main__":
    run_stage(practise)
