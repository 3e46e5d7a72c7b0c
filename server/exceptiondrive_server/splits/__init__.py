"""What the server may know about splits."""
