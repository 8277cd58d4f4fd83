"""Write the controller of one jump as C for a robot without leapgap; of goal-shift MPC its model as ONNX, too.

Examples:

    python -m stages.export export.hardware=worn 'export.target=[0.6,0.0]' export.out=controller
"""

from dataclasses import replace

from omegaconf import DictConfig

from leapgap.jumping.experiments.rig import LandSettings
from leapgap.jumping.export.write import ExportSettings, tracker_of, write_controller
from leapgap.runtime.executor import Executor
from leapgap.runtime.output_folder import whole_folder
from stages.common import output_folder, read_config, run_stage
from stages.sections.land import experiment_of

STAGE = "stages.export"


def export(config: DictConfig) -> None:
    """Let the robot practise, or read its practice; plan the jump, and write its controller."""
    chosen = read_config(ExportSettings, config.export, "export")
    executor = read_config(Executor, config.executor, "executor")
    settings = read_config(LandSettings, config.land, "land")
    settings = replace(settings, hardware=[chosen.hardware], methods=[chosen.method], only={})
    experiment = experiment_of(config, settings)
    out = output_folder(chosen.out, STAGE, (settings.references, chosen.landings, config.robot.model))
    tracker = tracker_of(chosen, experiment, executor)
    with whole_folder(out, STAGE) as folder:
        tables = write_controller(tracker, folder, chosen.about(experiment.robot.name))
    print(f"{chosen.in_words}, {tables.numbers['ROWS']} rows, {tables.numbers['UPDATES']} updates -> {out}")
    print(*chosen.ground_in_words(tracker), f"run it: cd {out} && gcc -O2 *.c -o jump -lm", sep="\n")


if __name__ == "__main__":
    run_stage(export)
