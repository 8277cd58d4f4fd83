"""Diagnose cases again with knowledge of their truth: with the true effect ablated, and with further jumps.

The first verdicts stay as they are.

Examples:

    python -m stages.revisit revisit.struck=2 revisit.out=revisits
"""

from functools import partial

from omegaconf import DictConfig

from leapgap.reports.revisits import Revisit, RevisitSettings
from leapgap.runtime.cache import ResultCache
from leapgap.runtime.executor import Executor
from leapgap.validation.case import CaseSetup
from stages.common import output_folder, read_config, run_stage
from stages.robot import load_robot
from stages.sections.diagnosis import diagnosis_settings
from stages.sections.revisit import planned_jumps

STAGE = "stages.revisit"


def revisit(config: DictConfig) -> None:
    """Choose the cases, diagnose them again, and write the results."""
    settings = read_config(RevisitSettings, config.revisit, "revisit")
    executor = read_config(Executor, config.executor, "executor")
    inputs = (settings.logs, settings.truth, settings.verdicts, settings.references, config.robot.model)
    cache, robot = ResultCache(output_folder(settings.out, STAGE, inputs, kept=True)), load_robot(config)
    world = read_config(CaseSetup, config.withhold.world, "withhold.world")
    diagnosing = diagnosis_settings(config, config.diagnose_withheld.settings)
    plan, pages = partial(planned_jumps, config, settings, robot), config.diagnose_withheld.pages
    Revisit(settings, diagnosing, robot, world, plan, cache, executor, pages).run(STAGE)


if __name__ == "__main__":
    run_stage(revisit)
