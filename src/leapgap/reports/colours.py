"""Colours of the figures on pages."""

REAL, NOMINAL, CORRECTED = "#111827", "#e2542f", "#2563c9"
"""Of what was measured, of the nominal simulation and of the corrected one."""
GREY = "#8a93a3"
