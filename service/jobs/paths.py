"""Which fields of a job's output are paths, and so the service's to choose."""

OURS = ("output", "frames_dir", "report", "debug_dir")
