"""Practice of the learned MPC on simulated hardware: rounds of jumps, each with the model of all rounds before it.

``land`` reads these jumps. A killed run goes on with the first jump that is not there.

Examples:

    python -m stages.practise 'land.hardware=[soft]' 'land.methods=[learned_variable]' practise.out=practice
"""

from omegaconf import DictConfig

from leapgap.jumping.experiments.landing_experiment import PractiseSettings, run_practice
from leapgap.jumping.experiments.rig import LandSettings
from leapgap.runtime.atomic_io import write_json
from leapgap.runtime.executor import Executor
from leapgap.runtime.output_folder import claim_folder
from stages.common import output_folder, read_config, run_stage
from stages.sections.land import experiment_of

STAGE, FIGURES = "stages.practise", "practice.json"


def practise(config: DictConfig) -> None:
    """Make the rounds of every method that practises, on all hardware of ``land``; those that are there are kept."""
    section = read_config(PractiseSettings, config.practise, "practise")
    settings = read_config(LandSettings, config.land, "land")
    executor = read_config(Executor, config.executor, "executor")
    experiment = experiment_of(config, settings)
    out = claim_folder(output_folder(section.out, STAGE, (settings.references, config.robot.model), kept=True), STAGE)
    write_json(out / FIGURES, run_practice(experiment, executor, out))


if __name__ == "__main__":
    run_stage(practise)
