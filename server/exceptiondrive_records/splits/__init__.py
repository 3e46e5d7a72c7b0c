"""What may be known of the splits."""
