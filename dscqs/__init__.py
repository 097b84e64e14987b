"""depthsr."""
