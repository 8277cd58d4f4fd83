"""Settings of stages whose sections hold sections of several kinds, one file a section."""
