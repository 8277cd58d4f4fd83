"""Evaluate the models on held-out jumps, or, with ``evaluate.logs``, the final ones on other jump logs.

Examples:

    python -m stages.evaluate evaluate.logs=jumps evaluate.out=predictions
"""

from omegaconf import DictConfig

from leapgap.jumping.reports.learning import EvaluateSettings, evaluate_held_out, evaluate_logs
from stages.common import output_folder, read_config, run_stage
from stages.robot import load_robot

STAGE = "stages.evaluate"


def evaluate(config: DictConfig) -> dict[str, float] | None:
    """Write the metrics and predictions of held-out jumps; with ``logs``, learning.json of those logs.

    Cross-validated errors are returned for a sweep.
    """
    settings = read_config(EvaluateSettings, config.evaluate, "evaluate")
    out = output_folder(settings.out, STAGE, (*settings.inputs, config.robot.model))
    if settings.logs is None:
        return evaluate_held_out(settings, out, STAGE)
    evaluate_logs(settings, load_robot(config), out, STAGE)
    return None


if __name__ == "__main__":
    run_stage(evaluate)
