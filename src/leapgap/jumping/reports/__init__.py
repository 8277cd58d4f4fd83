"""Pages and recordings of jumps: landings, learned models, planned references."""
