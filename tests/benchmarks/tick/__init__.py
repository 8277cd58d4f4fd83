"""Parts of the benchmarks of controllers' ticks."""
