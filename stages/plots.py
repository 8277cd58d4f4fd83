"""``dvc plots show`` or ``dvc plots diff`` as a page that opens without a network: ``plots/index.html``.

DVC's own page loads Vega from the net. Here it stands inside, from the package ``vl-convert-python`` (extra ``plots``).

Examples:

    python -m stages.plots
    python -m stages.plots diff HEAD~1
"""

import subprocess
from pathlib import Path

from leapgap.errors import InputError
from leapgap.runtime.atomic_io import write_text
from stages.common import program, run_command

TEMPLATE, OUT = Path(".dvc/tmp/plots.html"), Path("plots")
PAGE = """<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>leapgap: plots</title>
<style>
  body {{ font: 15px/1.55 system-ui, sans-serif; margin: 0 auto; max-width: 1100px; padding: 24px; }}
  body > div {{ margin: 0 0 36px; overflow-x: auto; }}
</style>
<script>{bundle}</script>
</head>
<body>
{{plot_divs}}
</body>
</html>
"""


def template() -> str:
    """The page with Vega inside, and a place for DVC's plots."""
    try:
        import vl_convert
    except ImportError:
        do = "pip install -c constraints.txt -e '.[plots]'"
        raise InputError("import", "no package vl-convert-python", "Vega for a page without a network", do) from None
    return PAGE.format(bundle=vl_convert.javascript_bundle().replace("</script", "<\\/script"))  # type: ignore[call-arg]


def plots(arguments: list[str]) -> int:
    """Write the template and let DVC fill it; DVC's exit code."""
    what, *others = arguments or ["show"]
    if what not in ("show", "diff"):
        raise InputError("command line", what, "show or diff", "python -m stages.plots diff HEAD~1")
    if not Path("dvc.yaml").is_file():
        raise InputError("dvc.yaml", "no such file", "the stages of a pipeline", "run it in the project's folder")
    write_text(TEMPLATE, template())
    command = [program("dvc"), "plots", what, *others, "--html-template", str(TEMPLATE), "-o", str(OUT)]
    return subprocess.run(command, check=False).returncode


if __name__ == "__main__":
    run_command("plots", plots)
