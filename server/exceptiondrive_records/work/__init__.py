"""What there is to do: queue, leases and dispatch."""
