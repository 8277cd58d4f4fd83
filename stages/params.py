"""Compose conf/ to params.yaml, the snapshot that DVC reads, and to the plans of tests beside it.

``conf/`` is the only place to change a setting. ``dvc repro`` does not compose by itself, so this first stage does;
``dvc exp run -S`` writes ``params.yaml`` itself, so this stage then leaves it alone, and takes the plans from it.

Examples:

    python -m stages.params
"""

import os

from omegaconf import OmegaConf

from stages.common import PARAMS, PLANS, run_command
from stages.compose import compose_conf, compose_params, plans_of, write_composed


def params(arguments: list[str]) -> None:
    """Write ``params.yaml`` and the plans; keep what an experiment has, and refuse what was edited by hand."""
    conf = compose_conf()
    if "DVC_EXP_NAME" in os.environ:
        print("params.yaml is the experiment's own: kept")
        conf = OmegaConf.to_container(OmegaConf.merge(conf, OmegaConf.load(PARAMS)))
    else:
        write_composed(PARAMS, compose_params())
    for name, text in plans_of(conf).items():
        write_composed(PLANS / f"{name}.yaml", text)


if __name__ == "__main__":
    run_command("params", params)
