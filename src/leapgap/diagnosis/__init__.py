"""Diagnosis of the sim-to-real gap: where it lies, which effects cause it, how far correcting them reduces it."""
