"""The protocol documents."""
