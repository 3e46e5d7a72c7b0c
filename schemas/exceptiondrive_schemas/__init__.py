"""What crosses a process boundary, and nothing else: files, messages, names and codes.

Every other package stands on this one; it stands on pydantic alone.
"""
