"""The protocol documents that are shipped, and checks and comparison of any protocol document."""
