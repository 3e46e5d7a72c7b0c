"""From driving scenes to a frozen split (docs/building-a-split.md)."""
