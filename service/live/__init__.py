"""Watching while it is made: fragments stored once, handed to every viewer."""
