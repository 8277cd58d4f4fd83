"""How the library runs: processes and workers, outputs written whole, the cache of results, what code depends on."""
