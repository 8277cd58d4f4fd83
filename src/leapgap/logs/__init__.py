"""What happened: the jump log, importers, checks of its form, windows."""
