"""The page of a report: a template, its style and its script."""
