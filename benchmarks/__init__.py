"""Benchmarks: `python -m benchmarks` prints the comparisons of docs/performance.md in one run."""
