"""Write the results of the pipeline as Rerun recordings; ``rerun <out>/*.rrd`` shows them."""

from omegaconf import DictConfig

from leapgap.atomic_io import whole_folder
from leapgap.jumping.reports.record_all import View, record_all
from stages.common import output_folder, read_config, run_stage
from stages.robot import load_robot


def view(config: DictConfig) -> None:
    """Record references, jumps with their simulated ghosts, and predictions; empty folders are skipped."""
    chosen = read_config(View, config.view, "view")
    out = output_folder(chosen.out)
    with whole_folder(out) as beside:
        for line in record_all(chosen, load_robot(config), beside):
            print(line)
    print(f"look at them: rerun {out}/*.rrd")


if __name__ == "__main__":
    run_stage(view)
