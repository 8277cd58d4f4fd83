"""Landing errors of each method in closed-loop experiments on simulated hardware that no controller knows.

Examples:

    python -m stages.land 'land.methods=[ours,joint_pd]' 'land.hardware=[worn]' land.out=landings
"""

from omegaconf import DictConfig

from leapgap.jumping.experiments.landing_experiment import PAGE, remove_figures, run_landings, write_landings
from leapgap.jumping.experiments.rig import LandSettings
from leapgap.runtime.atomic_io import write_text
from leapgap.runtime.executor import Executor
from leapgap.runtime.output_folder import claim_folder
from stages.common import output_folder, read_config, run_stage
from stages.sections.land import experiment_of

STAGE = "stages.land"


def land(config: DictConfig) -> dict[str, float]:
    """Run all methods on all hardware and tasks; cached results are reused. Mean errors are returned for a sweep."""
    settings = read_config(LandSettings, config.land, "land")
    executor = read_config(Executor, config.executor, "executor")
    experiment = experiment_of(config, settings)
    inputs = (settings.references, settings.published, settings.corrected, *settings.models.values())
    out = claim_folder(output_folder(settings.out, STAGE, (*inputs, config.robot.model), kept=True), STAGE)
    remove_figures(out)
    errors = write_landings(run_landings(experiment, executor, out), settings, out)
    if settings.pages:
        from leapgap.jumping.reports.landing import html_of

        write_text(out / PAGE, html_of(out, settings.single))
        print(f"look at it: {out / PAGE}")
    return errors


if __name__ == "__main__":
    run_stage(land)
