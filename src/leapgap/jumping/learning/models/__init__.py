"""Models of the base, a file each: the model, the settings that are its own, and its recipes."""
