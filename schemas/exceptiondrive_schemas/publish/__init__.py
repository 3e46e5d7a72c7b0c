"""Generates the published files about the formats: JSON Schemas, examples, the page of errors.

`python -m exceptiondrive_schemas.publish` writes all of it; a test fails if a file is stale.
"""
