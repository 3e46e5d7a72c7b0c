"""The protocol documents that are shipped, and what is said of any protocol document."""
