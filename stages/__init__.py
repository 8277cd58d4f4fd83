"""One thin file a stage: read config and inputs, call one function, write the output."""

import os
import sys
from importlib.util import find_spec

# Sums of BLAS depend on its number of threads, and a stage already uses one process a core: so one thread each, which
# makes the outputs independent of the machine's cores and is faster. It must be set before numpy is imported.
for library in ("OMP", "OPENBLAS", "MKL"):
    os.environ[f"{library}_NUM_THREADS"] = "1"

if sys.argv[:1] == ["-m"]:  # `python -m stages.<stage>` imports this first: Ctrl-C may come while it imports
    from leapgap.runtime.output_folder import what_is_kept
    from leapgap.runtime.processes import InterruptGuard, tolerate_terminal
    from stages.help import answered_at_once

    tolerate_terminal()
    STAGE = next((word for word in sys.orig_argv if word.startswith("stages.")), "stages")
    if answer := answered_at_once(STAGE.removeprefix("stages."), sys.argv[1:]):
        print(answer, end="")
        sys.exit(0)
    if find_spec("hydra") is None:  # the environment of `make demo` has the instrument alone
        do = "run `make .venv/ready`, or pip install 'leapgap[pipeline]'"
        print(f"{STAGE}: found no hydra-core; expected the packages of the pipeline; {do}", file=sys.stderr)
        sys.exit(2)
    InterruptGuard(lambda: f"{STAGE}: stopped by Ctrl-C; {what_is_kept()}").install()
elif "LEAPGAP_PARENT" in os.environ:  # a worker of a stage, which imports the stage before it can do anything else
    from leapgap.runtime.processes import end_with_parent_early

    end_with_parent_early()
