"""The way in and out for streams: key expressions, one protocol, zenoh behind it."""
