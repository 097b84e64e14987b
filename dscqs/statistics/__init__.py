"""Statistics of subjective tests: arrays and votes in, numbers out; no files, no clock."""
