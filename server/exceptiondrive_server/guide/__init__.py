"""Reference pages and documents: help for every problem, the API, schemas and examples."""
