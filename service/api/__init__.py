"""The HTTP side: routes, schemas, problem details. Knows the use cases, and no SQL."""
