"""Benchmarks: `python -m benchmarks` prints every comparison of docs/performance.md in one run."""
