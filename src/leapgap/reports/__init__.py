"""Recordings and reports for people: Rerun and HTML."""
