"""Live streams: cameras in over the bus, super-resolved pictures out over it."""
