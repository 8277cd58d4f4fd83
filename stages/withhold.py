"""Generate cases whose cause is withheld: logs for the diagnosis, sealed truths for the score.

Examples:

    python -m stages.withhold size=tiny withhold.logs=withheld/logs withhold.truth=withheld/truth
"""

from omegaconf import DictConfig

from leapgap.runtime.executor import Executor
from leapgap.runtime.output_folder import whole_folder
from leapgap.validation.seal import SEALS
from stages.common import output_folder, read_config, run_stage
from stages.robot import load_robot
from stages.sections.withhold import WithholdSettings, draw_all

STAGE = "stages.withhold"


def withhold_all(config: DictConfig) -> None:
    """Draw the cases, generate their jumps, and seal their truths."""
    settings = read_config(WithholdSettings, config.withhold, "withhold")
    executor = read_config(Executor, config.executor, "executor")
    inputs = (settings.references, settings.published, config.robot.model)
    logs_out = output_folder(settings.logs, STAGE, inputs, name="logs")
    truth_out = output_folder(settings.truth, STAGE, (*inputs, logs_out), name="truth")
    drawn = draw_all(settings, config.withhold, load_robot(config))
    with whole_folder(truth_out, STAGE) as truths, whole_folder(logs_out, STAGE) as logs:
        drawn.write(logs, truths, executor)
    print(*drawn.in_words, sep="\n", end=f"; seals: {logs_out / SEALS}\n")


if __name__ == "__main__":
    run_stage(withhold_all)
