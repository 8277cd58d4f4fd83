"""Write the results of the pipeline as Rerun recordings; ``rerun <out>/*.rrd`` shows them.

Examples:

    python -m stages.view view.out=views
"""

from omegaconf import DictConfig

from leapgap.jumping.reports.record_all import View, record_all
from leapgap.runtime.output_folder import whole_folder
from stages.common import output_folder, read_config, run_stage
from stages.robot import load_robot

STAGE = "stages.view"


def view(config: DictConfig) -> None:
    """Record references, jumps with their simulated ghosts, and predictions; empty folders are skipped."""
    chosen = read_config(View, config.view, "view")
    out = output_folder(chosen.out, STAGE, [*folders_of(chosen), config.robot.model])
    with whole_folder(out, STAGE) as beside:
        for line in record_all(chosen, load_robot(config), beside):
            print(line)
    print(f"look at them: rerun {out}/*.rrd")


def folders_of(view: View) -> list[str | None]:
    """Every folder that is read."""
    replays = view.replays_damped, view.replays_published
    predictions = view.predictions_simulated, view.predictions_published
    return [view.references, view.simulated, view.damped, view.published, *replays, *predictions, view.landings]


if __name__ == "__main__":
    run_stage(view)
