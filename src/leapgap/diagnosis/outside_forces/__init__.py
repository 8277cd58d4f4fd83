"""Forces and moments from outside: when they acted, at which joint or on the base, and how large they were."""
