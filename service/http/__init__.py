"""The HTTP doors of the service: one module a resource, problems and tokens of their own."""
