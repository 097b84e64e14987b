"""Which fields of an output are not the client's to choose; loads nothing."""

OURS = ("output", "frames_dir", "report", "debug_dir")
"""Paths: the service chooses them."""

NOT_OF_EXPORTS = (*OURS, "view_at", "segment_length")
"""The same of an export, which is made of the eyes that a finished job has made."""

NO_EXPORTS = {"layout": ("views",)}
"""Choices that an export has not, by field."""
