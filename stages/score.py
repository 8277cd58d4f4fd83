"""Open the truths, score the verdicts, and write metrics and a page.

Examples:

    python -m stages.score score.verdicts=verdicts score.out=page
"""

from omegaconf import DictConfig

from leapgap.reports.validation import write_scores
from leapgap.validation.half_scores import ScoreSettings, open_outcomes
from stages.common import output_folder, read_config, run_stage
from stages.robot import load_robot

STAGE = "stages.score"


def score(config: DictConfig) -> dict[str, float]:
    """Open every truth whose case has a verdict, and write the scores, which are returned for a sweep."""
    settings = read_config(ScoreSettings, config.score, "score")
    inputs = (settings.logs, settings.truth, settings.verdicts, settings.revisits, config.robot.model)
    out = output_folder(settings.out, STAGE, inputs)
    robot = load_robot(config)
    return write_scores(open_outcomes(settings, robot), settings, robot, out, STAGE)


if __name__ == "__main__":
    run_stage(score)
