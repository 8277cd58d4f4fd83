"""Full-body trajectory optimisation of a jump, and the reference that it gives."""
