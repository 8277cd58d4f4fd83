"""The page of landings that stage `land` left: errors, forces, joints, pitch and fallbacks of each method.

Examples:

    python -m stages.land_page land_page.landings=data/landings land_page.out=page
"""

from pathlib import Path

from omegaconf import DictConfig

from leapgap.jumping.experiments.landing_experiment import PAGE
from leapgap.jumping.reports.landing import LandPageSettings, html_of
from leapgap.runtime.atomic_io import write_text
from leapgap.runtime.output_folder import whole_folder
from stages.common import output_folder, read_config, run_stage

STAGE = "stages.land_page"


def land_page(config: DictConfig) -> None:
    """Write the page of a folder of landings, with those methods in detail that the settings name as single."""
    settings = read_config(LandPageSettings, config.land_page, "land_page")
    out = output_folder(settings.out, STAGE, (settings.landings,))
    with whole_folder(out, STAGE) as folder:
        write_text(folder / PAGE, html_of(Path(settings.landings), settings.single))
    print(f"look at it: {out / PAGE}")


if __name__ == "__main__":
    run_stage(land_page)
