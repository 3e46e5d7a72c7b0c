"""The facts that the server may know about splits."""
