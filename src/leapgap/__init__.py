"""leapgap: where a legged robot differs from its simulation, why, and how far the gap shrinks."""
