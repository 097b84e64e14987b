"""Votes in the formats of others: tidy CSV, suJSON, datasets of sureal. Nothing is executed."""
