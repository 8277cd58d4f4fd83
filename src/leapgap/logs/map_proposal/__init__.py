"""Proposal of a column map for logs of strangers: by the names of their columns, then by physics."""
