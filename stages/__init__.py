"""One thin file a stage: read config and inputs, call one function, write the output."""
