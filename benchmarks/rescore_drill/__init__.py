"""The drill of a protocol update: `python -m benchmarks.rescore_drill --database sqlite|postgres`."""
