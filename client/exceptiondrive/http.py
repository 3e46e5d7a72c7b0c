"""The one door to the HTTP library: a switch to httpx2 changes this import and nothing else."""

import httpx

__all__ = ["httpx"]
