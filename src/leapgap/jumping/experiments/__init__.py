"""Closed-loop experiments: who jumps (methods), what (tasks), on which hardware, and where it lands."""
