"""From many small views to a large stereo pair; the map of its rooms is ``pipeline/README.md``."""
