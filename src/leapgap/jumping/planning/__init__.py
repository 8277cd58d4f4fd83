"""Full-body trajectory optimisation of a jump, and the reference it leaves."""
