"""Generates what is published about the formats: JSON Schemas, examples, the page of errors.

`python -m exceptiondrive_schemas.publish` writes all of it; a test fails where a file is stale.
"""
