"""Logs of robots: format, checks, importers, conversion to motions."""
