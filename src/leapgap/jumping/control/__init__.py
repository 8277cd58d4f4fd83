"""Joint-level tracking and the forces it stands for."""
