"""What the API alone says and takes; documents that are kept as files lie one folder up."""
