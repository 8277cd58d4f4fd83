"""One thin file a stage: read config and inputs, call one function, write the output."""

import os

# Sums of BLAS depend on its number of threads, and a stage already uses one process a core: so one thread each, which
# makes the outputs independent of the machine's cores and is faster. It must be set before numpy is imported.
for library in ("OMP", "OPENBLAS", "MKL"):
    os.environ.setdefault(f"{library}_NUM_THREADS", "1")
