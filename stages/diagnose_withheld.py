"""Diagnose the withheld cases, each in a folder that holds only copies of its logs and of the robot.

Examples:

    python -m stages.diagnose_withheld 'diagnose_withheld.only=[case_000]' diagnose_withheld.out=verdicts
"""

from omegaconf import DictConfig

from leapgap.reports.verdict_jobs import DiagnoseWithheldSettings, cases_of, run_cases
from leapgap.runtime.cache import ResultCache
from leapgap.runtime.executor import Executor
from leapgap.runtime.output_folder import claim_folder
from stages.common import output_folder, read_config, run_stage
from stages.robot import load_robot
from stages.sections.diagnosis import diagnosis_settings

STAGE = "stages.diagnose_withheld"


def diagnose_withheld(config: DictConfig) -> None:
    """Diagnose the cases without a valid verdict; remove the verdicts of cases that no longer exist."""
    settings = read_config(DiagnoseWithheldSettings, config.diagnose_withheld, "diagnose_withheld")
    executor = read_config(Executor, config.executor, "executor")
    out = output_folder(settings.out, STAGE, (settings.logs, config.robot.model), kept=True)
    cases = cases_of(settings)
    own, robot = diagnosis_settings(config, settings.settings), load_robot(config).path
    run_cases(cases, settings, own, robot, ResultCache(claim_folder(out, STAGE)), executor)


if __name__ == "__main__":
    run_stage(diagnose_withheld)
