"""Pages and documents that explain: help for every problem, the API, schemas and examples."""
